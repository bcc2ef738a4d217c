"""Deprecated module name of version 1.0; the module is now `thinlayer.discretisation.part_definition`."""

from thinlayer.discretisation.part_definition import PartDefinition
from thinlayer.errors import getattr_with_former_names

__getattr__ = getattr_with_former_names(__name__, {"Addition": PartDefinition})
