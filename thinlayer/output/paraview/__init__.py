"""Files for ParaView (`thinlayer.fields`): the function that writes them, the VTK blocks, and cells in VTK's order."""
