"""What the command `estimate` was asked: files, options, and the description that they make."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thinlayer.describing.description import Description
from thinlayer.describing.section import DescriptionError
from thinlayer.describing.source import OF_MESH, OPTIONS, PLAIN, Source, sorted_files

if TYPE_CHECKING:
    from thinlayer.describing.case import Case


@dataclass(frozen=True)
class Asked:
    """Files and options of an estimate, checked as far as that is possible without the mesh.

    Attributes:
        files: mesh file and description, those that there are.
        options: the options that were given, for run.json.
        description: what they say; None: a file in Python says it.
    """

    files: tuple[Path, ...]
    options: Mapping[str, Any]
    description: Description | None

    @classmethod
    def of(cls, chosen: argparse.Namespace) -> Asked:
        """What the arguments of the command line ask.

        Raises:
            DescriptionError: where, what is wrong, and what is allowed.
        """
        mesh, file = sorted_files(chosen.files)
        given = {name: getattr(chosen, name.replace("-", "_")) for name in (*OPTIONS, *PLAIN, *OF_MESH)}
        given = {name: value for name, value in given.items() if value}
        options = {**given, **({"bonded": True} if chosen.bonded else {})}
        if file is not None and file.suffix.lower() == ".py":
            if mesh or options:
                beside = str(mesh) if mesh else f"--{next(iter(options))}"
                raise DescriptionError(
                    f"{file} is a description in Python and says all by itself; {beside} is beside it"
                )
            if not file.is_file():
                raise DescriptionError(f"{file} is no file")
            return cls((file,), options, None)
        source = Source.read(file) if file else Source("the command line")
        if mesh:
            source.mesh(str(mesh))
        for name, value in given.items():
            source.take(name, value)
        if chosen.bonded:
            source.values["bonded"] = True
        description = Description.of(source.section())
        files = tuple(one for one in (description.mesh.path, file) if one)
        if folders := [one for one in files if one.is_dir()]:
            raise DescriptionError(f"{folders[0]}: this is a folder, not a file")
        return cls(files, options, description)

    @property
    def name(self) -> str:
        """Of the description, or of the mesh file."""
        return self.files[-1].stem

    def case(self) -> Case:
        """The structure and what is asked of it. Collective; errors as of `Case.of` and `case_in`."""
        from thinlayer.describing.case import Case
        from thinlayer.describing.python import case_in

        return case_in(self.files[-1]) if self.description is None else Case.of(self.description)
