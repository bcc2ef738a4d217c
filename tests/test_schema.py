"""The JSON schema of descriptions, by which editors complete and check them: it and the reader refuse the same.

`test_descriptions.described` checks that each description which is read there has the schema.
"""

from __future__ import annotations

import re

import pytest

from forms.base import InputError
from tests.documents import CLONE
from tests.json_schema import SCHEMA, is_valid
from tests.test_bad_inputs import LEAST, TABLE
from tests.test_cli import thinlayer
from thinlayer import Units
from thinlayer.running.description import Description
from thinlayer.running.materials import _law_keys, laws_by_name
from thinlayer.running.quantities import KINDS
from thinlayer.running.toml_table import read_input_file
from thinlayer.system.units import DIMENSIONS

DATA = CLONE / "studies/data"
# what depends on several entries, on sizes of numbers, or on units that are not common
READER_ALONE = r"""is 0$|is -1|is 0.5$|nan|\binf\b|shape of C|must be a list of numbers|number of sublayers
|sum of the fractions|has a unit; name those|unknown component 'n'|a time series needs times|nothing loads|are not times
|unknown quantity|name a third unit|force per length|'1 cells'|the stress is '1 mm'""".replace("\n", "")


def test_the_file_of_the_schema_is_what_the_command_prints():
    """`python3 -m thinlayer schema > studies/data/thinlayer.schema.json` writes it anew."""
    assert (DATA / "thinlayer.schema.json").read_text(encoding="utf-8") == thinlayer("schema").stdout


def test_descriptions_of_studies_name_the_schema_and_have_it():
    descriptions = [file for file in DATA.glob("*.toml") if re.search("^mesh =", file.read_text(), re.MULTILINE)]
    assert sorted(file.name for file in descriptions) == ["lap.toml", "pad.toml"]
    for file in descriptions:
        assert file.read_text().startswith("#:schema thinlayer.schema.json\n")
        assert is_valid(read_input_file(file).values)


@pytest.mark.parametrize("kind", ["settings", "quantities"])
def test_bad_inputs(tmp_path, kind):
    """Those that need a mesh to be refused have the schema."""
    file, refused_by_both = tmp_path / "a.toml", 0
    file.write_text(LEAST)
    for setting, words in TABLE[kind]:
        settings = [setting] if kind == "settings" else setting.split("; ")
        try:
            values = read_input_file(file, settings).values
        except InputError:
            continue  # no TOML
        try:
            is_read = bool(Description.read(file, settings))
        except InputError:
            is_read = False
        refused_by_both += not is_read and not is_valid(values)
        assert is_valid(values) or not is_read, setting
        assert is_read or not is_valid(values) or re.search(READER_ALONE, words), setting
    assert refused_by_both >= {"settings": 90, "quantities": 5}[kind]


@pytest.mark.parametrize("name", laws_by_name())
def test_laws(name):
    """Each required key, no other key, one set of moduli; a body has no thickness, and a layer has."""
    keys, moduli = _law_keys(name)
    values = {"frame": "layer", "C": [[1.0] * 6] * 6, "chi": [1, 2, 3]}
    values["sublayers"] = [{"fraction": 0.4, "E": 6, "nu": 0.1}, {"fraction": 0.6, "law": "Norton", "G": 3, "nu": 0.2}]
    values["sublayers"][1] |= {"eta": "3 MPa s", "p": 2}
    needed = ["eps", *keys.hints, *(moduli[0] if moduli else [])]
    least = {"law": name, **{key: values.get(key, 0.5) for key in needed}}
    has_schema = lambda table, kind="layer": is_valid(table, SCHEMA["properties"][kind])
    assert has_schema(least)
    assert has_schema({"A": least, "B": least | {"eigenstrain": "1 %"}})
    assert has_schema({key: value for key, value in least.items() if key != "eps"}, "body")
    assert not has_schema(least, "body")
    for key in needed:
        assert not has_schema({other: value for other, value in least.items() if other != key}), key
        assert not has_schema({"A": least, "B": {**least, key: True}}), key
    for more in ({"x": 1}, {"fraction": 0.5}, {"law": name + "x"}, *({key: 1} for key in {"K", "lmbda"} - {*least})):
        assert not has_schema(least | more), more


def test_units():
    """Texts are those of a kind; a force may be one per length, as that depends on the structure."""
    units = Units("mm", "MPa", "s")
    texts = "2 GPa|-3psi|.5 N/mm**2|0.2mm|7 um|1e-3 inch|5 kN|30 N/cm|77 kN/m^3|3 h|1 day|5 %|0.3 mm/m|30 deg|2 GPaa|2"
    keys = {kind: key for key, kind in KINDS.items() if kind} | {"time": "times", "force per volume": "body_force"}
    cells = {kind: SCHEMA["definitions"]["material"]["properties"].get(key) for kind, key in keys.items()}
    cells["time"] = SCHEMA["properties"]["times"]["items"]
    cells["force per volume"] = SCHEMA["properties"]["body_force"]["items"]
    cells["force"] = SCHEMA["properties"]["loads"]["items"]["anyOf"][0]["properties"]["force"]["anyOf"][0]["items"]
    cells["length"] = SCHEMA["definitions"]["material"]["properties"]["eps"]
    assert cells.keys() == DIMENSIONS.keys() - {"force per length"}
    for kind, schema in cells.items():
        assert is_valid(1.5, schema)
        for text in texts.split("|"):
            try:
                is_of_kind = bool(units(text, kind))
            except InputError:
                is_of_kind = kind == "force" and text == "30 N/cm"
            if kind in ("ratio", "angle"):  # both have no dimension, and each its units
                is_of_kind &= text.endswith(("deg", "rad")) == (kind == "angle")
            assert is_valid(text, schema) == is_of_kind, (kind, text)
