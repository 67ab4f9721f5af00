"""The stub of the compiled core names its classes, members and functions, with their numbers of parameters."""

import ast
import enum
import re

import lieeuler._kernel as kernel
from tests import ROOT


def declared(body, prefix=""):
    """Names of a stub's body with their numbers of parameters; None for what is no function."""
    found = {}
    for node in body:
        if isinstance(node, ast.FunctionDef):
            accessor = any(getattr(each, "id", "") == "property" for each in node.decorator_list)
            found[prefix + node.name] = None if accessor else parameters(node)
        elif isinstance(node, ast.ClassDef):
            found |= {prefix + node.name: None} | declared(node.body, f"{prefix}{node.name}.")
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            found[prefix + target.id] = None
    return found


def parameters(function):
    """All are positional: the core gives them no names."""
    assert not function.args.args
    assert function.args.vararg is None
    return len(function.args.posonlyargs)


def compiled(holder, prefix=""):
    found = {}
    for name, content in vars(holder).items():
        if isinstance(content, type) and issubclass(content, enum.Enum):
            found |= {prefix + name: None} | {f"{prefix}{name}.{member}": None for member in content.__members__}
        elif isinstance(content, type):
            found |= {prefix + name: None} | compiled(content, f"{prefix}{name}.")
        elif hasattr(content, "__nb_signature__") and (not name.startswith("_") or name == "__init__"):
            # nanobind writes the shapes of arrays in a way that Python cannot read.
            text = re.sub(r"ndarray\[[^]]*\]", "object", content.__nb_signature__[0][0])
            found[prefix + name] = parameters(ast.parse(text + ": ...").body[0])
        elif not name.startswith("_"):
            found[prefix + name] = None
    return found


def test_the_stub_is_complete():
    stub = declared(ast.parse((ROOT / "lieeuler" / "_kernel.pyi").read_text()).body)
    core = compiled(kernel)
    assert len(core) > 30
    assert stub == core
