"""Meshed layers: S is opened to bands of cells with the layers' thickness, and the bodies move apart."""
