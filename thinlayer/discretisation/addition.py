"""Deprecated module name of version 1.0; the module is now `thinlayer.discretisation.part_definition`."""

from thinlayer.errors import make_module_getattr

__getattr__ = make_module_getattr(__name__, {"Addition": "thinlayer.discretisation.part_definition.PartDefinition"})
