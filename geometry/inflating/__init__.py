"""Meshed layers: S is opened to the layers' thickness, layers get cells, and bodies move apart or give way."""
