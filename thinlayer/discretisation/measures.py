"""Forms with measures with and without tags of the mesh."""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem

from forms.kinematics import Expr
from thinlayer.errors import ModelError

SHORT = {"cell": "dx", "exterior_facet": "ds", "interior_facet": "dS"}


def compiled(form: Expr) -> fem.Form:
    """Compile a form, which may have measures with tags and plain ones (DOLFINx itself refuses this).

    Raises:
        ModelError: measures of one kind with two sets of tags.
    """
    first, *others = _with_one_set_of_tags(form)
    if others:
        kind = others[0].integrals()[0].integral_type()
        name = SHORT.get(kind, kind)
        raise ModelError(f"a form has two measures {name} with different tags; use model.{name} for all of them")
    return fem.form(first)


def compiled_summands(form: Expr) -> list[fem.Form]:
    """Compiled forms whose sum is a form, in which measures of one kind may have any sets of tags."""
    return [fem.form(one) for one in _with_one_set_of_tags(form)]


def _with_one_set_of_tags(form: Expr) -> list[ufl.Form]:
    """Forms whose sum is the form. Each has one set of tags per kind of measure, as DOLFINx requires."""
    found: list[tuple[dict[str, Any], list[Any]]] = [({}, [])]
    for integral in form.integrals():
        kind, data = integral.integral_type(), integral.subdomain_data()
        for tags, integrals in found:
            if data is None or tags.setdefault(kind, data) is data:
                integrals.append(integral)
                break
        else:
            found.append(({kind: data}, [integral]))
    return [
        ufl.Form([one.reconstruct(subdomain_data=tags.get(one.integral_type())) for one in integrals])
        for tags, integrals in found
    ]
