"""Files for ParaView (`thinlayer.fields`): the writer, the blocks that it writes, and the cells in VTK's order."""
