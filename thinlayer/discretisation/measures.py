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
    tags: dict[str, Any] = {}
    for integral in form.integrals():
        kind, found = integral.integral_type(), integral.subdomain_data()
        if found is not None and tags.setdefault(kind, found) is not found:
            name = SHORT.get(kind, kind)
            raise ModelError(f"a form has two measures {name} with different tags; use model.{name} for all of them")
    integrals = [one.reconstruct(subdomain_data=tags.get(one.integral_type())) for one in form.integrals()]
    return fem.form(ufl.Form(integrals))
