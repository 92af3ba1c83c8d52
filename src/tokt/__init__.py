"""tokt: label, train, compare and deploy small texture models that keep an ROV off obstacles.

The public names stand in ``__init__.pyi``. Each is loaded from its module when it is first used:
``import tokt`` brings no numpy, and the runtime's pieces need no extra.
"""


def _public() -> dict[str, str]:
    """Module of each public name, as the stub beside this file has it."""
    import ast
    from pathlib import Path

    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8"))
    imports = (node for node in stub.body if isinstance(node, ast.ImportFrom))
    return {name.name: str(one.module) for one in imports for name in one.names}


def __dir__() -> list[str]:
    return sorted({*globals(), *_public(), "__all__", "__version__"})


_MEANT = {
    **dict.fromkeys(("classify", "detect", "infer", "predict"), "judge_image"),
    **dict.fromkeys(("fit", "train_model"), "train"),
    **dict.fromkeys(("open_folder", "open_video", "read_video"), "open_source"),
    "load_dataset": "build_dataset",
    "score": "evaluate",
}
"""Our public names, by what others call the same."""


def _guesses(name: str, public: dict[str, str]) -> str:
    """Name the public names that somebody may have meant; few guess that models are loaded."""
    from difflib import get_close_matches

    if name in ("mlflow", "sklearn"):
        return f": import tokt.{name} first"
    if name in _MEANT:
        return f"; there is tokt.{_MEANT[name]}"
    lower = {each.lower(): each for each in public}
    near = [each for each in lower if name.lower() in each]
    alike = name.lower().replace("bundle", "model")  # a bundle is loaded by `load_model`
    near = dict.fromkeys([*near[:3], *get_close_matches(alike, lower, cutoff=0.65)])
    alike = ", ".join(f"tokt.{lower[each]}" for each in near)
    return f"; there is {alike}" if near else "; dir(tokt) lists the names, commands do the rest"


def __getattr__(name: str) -> object:
    """Look a name up when it is asked for: the version alone takes a tenth of a start."""
    if name == "__version__":
        from importlib.metadata import version

        return version("tokt")
    public = {} if name.startswith("_") and name != "__all__" else _public()
    if name == "__all__":
        return sorted(public)
    if name not in public:
        raise AttributeError(f"module 'tokt' has no attribute {name!r}{_guesses(name, public)}")
    from importlib import import_module

    from tokt.features.common.extras import needed_by

    with needed_by(f"tokt.{name}"):
        globals()[name] = found = getattr(import_module(public[name]), name)
    return found
