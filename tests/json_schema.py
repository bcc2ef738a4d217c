"""The JSON schema of descriptions, and a check of values by the words of the draft 7 that it has."""

from __future__ import annotations

import json
import re

from thinlayer.running.description import description_schema

SCHEMA = json.loads(json.dumps(description_schema()))
TYPES = {"string": str, "boolean": bool, "array": list, "object": dict}


def is_valid(value, schema=SCHEMA):
    """Whether a value has a JSON schema; a word of the draft 7 that is not below is an error."""
    if isinstance(schema, bool):
        return schema
    return all(holds(word, value, schema) for word in schema if word not in ("then", "else"))


def holds(word, value, schema):
    wanted, is_table, is_list = schema[word], isinstance(value, dict), isinstance(value, list)
    is_text, is_number = isinstance(value, str), isinstance(value, (int, float)) and not isinstance(value, bool)
    branch = lambda: "then" if is_valid(value, wanted) else "else"
    types = lambda: [wanted] if isinstance(wanted, str) else wanted
    named = schema.get("properties", {})
    return {
        "$ref": lambda: is_valid(value, SCHEMA["definitions"][wanted.removeprefix("#/definitions/")]),
        "type": lambda: any(is_number if t == "number" else isinstance(value, TYPES[t]) for t in types()),
        "enum": lambda: value in wanted,
        "const": lambda: (type(value), value) == (type(wanted), wanted),
        "pattern": lambda: not is_text or re.search(wanted, value),
        "minLength": lambda: not is_text or len(value) >= wanted,
        "exclusiveMinimum": lambda: not is_number or value > wanted,
        "exclusiveMaximum": lambda: not is_number or value < wanted,
        "items": lambda: not is_list or all(is_valid(item, wanted) for item in value),
        "minItems": lambda: not is_list or len(value) >= wanted,
        "maxItems": lambda: not is_list or len(value) <= wanted,
        "properties": lambda: not is_table or all(is_valid(value[key], wanted[key]) for key in wanted.keys() & value),
        "additionalProperties": lambda: (
            not is_table or all(is_valid(value[key], wanted) for key in value.keys() - named.keys())
        ),
        "required": lambda: not is_table or {*wanted} <= value.keys(),
        "minProperties": lambda: not is_table or len(value) >= wanted,
        "anyOf": lambda: any(is_valid(value, item) for item in wanted),
        "allOf": lambda: all(is_valid(value, item) for item in wanted),
        "oneOf": lambda: sum(is_valid(value, item) for item in wanted) == 1,
        "if": lambda: is_valid(value, schema.get(branch(), True)),
        **dict.fromkeys(("description", "title", "$schema", "definitions"), lambda: True),
    }[word]()
