"""Compiled pixel and point loops; each has its plain twin in the tests."""

import logging
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

from llvmlite.binding import add_symbol, parse_assembly, parse_bitcode
from numba import njit
from numba.core.caching import CompileResultCacheImpl, FunctionCache, UserProvidedCacheLocator
from numba.core.compiler import CompileResult
from numba.core.environment import Environment, lookup_environment
from numba.core.runtime._nrt_python import c_helpers

P = ParamSpec("P")
R = TypeVar("R")

_log = logging.getLogger(__name__)

# Of numba's runtime, for kernels that make arrays: all that is not in their code.
for _name, _place in c_helpers.items():
    add_symbol(_name if _name.startswith("_") else f"NRT_{_name}", _place)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel on its first call and keep the machine code on disk for the next process."""
    kernel: Any = njit(nogil=True)(function)
    if kernel is function:  # numba is switched off
        return kernel
    kernel._compilation_chain_init_hook = lambda: None  # noqa: SLF001 - no look for extensions in all packages
    try:
        kernel._cache = _KeptCode(function)  # type: ignore[no-untyped-call]  # noqa: SLF001 - as `cache=True` does
    except RuntimeError as error:  # numba found no folder to write to
        if "cannot cache" not in str(error):
            raise
        _warn()
    return cast("Callable[P, R]", kernel)


@cache
def _warn() -> None:
    """Say once why every start takes long."""
    _log.warning(
        "compiled kernels cannot be kept on disk, so every start compiles them anew (20 s and more). "
        "Set NUMBA_CACHE_DIR to a folder that can be written."
    )


class _ReadOnlyFolder(UserProvidedCacheLocator):
    """The folder NUMBA_CACHE_DIR of a container whose file system cannot be written: what lies there is used."""

    def ensure_cache_path(self) -> None:
        """Raise OSError where nothing was kept."""
        if not Path(self.get_cache_path()).is_dir():  # type: ignore[no-untyped-call]
            raise FileNotFoundError(self.get_cache_path())  # type: ignore[no-untyped-call]


class _Code(CompileResultCacheImpl):
    """What is kept of a kernel, and where.

    numba keeps the environment of every function that a kernel calls with the name of its module, and imports them
    all (170 of its own) to read a kernel. Only the constants of an environment are ever used without Python objects.
    And it reads the LLVM code beside the machine code, which takes as long: only kernels that are compiled need that of
    those that they call.
    """

    _locator_classes = CompileResultCacheImpl._locator_classes + [_ReadOnlyFolder]  # noqa: SLF001, RUF005 - as numba has it

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """Return a name that numba's own form of a kernel does not have."""
        return f"{super().get_filename_base(fullname, abiflags)}-plain2"  # type: ignore[no-untyped-call]

    def reduce(self, cres: Any) -> tuple[Any, ...]:  # noqa: ANN401 - a named tuple without types
        """Return the parts of a compiled kernel, with the constants of its environments, and what it defines."""
        *parts, environments = super().reduce(cres)  # type: ignore[no-untyped-call]
        module = cres.library._get_module_for_linking()  # noqa: SLF001 - which has just been made
        defined = [each.name for each in (*module.functions, *module.global_variables) if not each.is_declaration]
        return defined, *parts, [(each.env_name, each.globals["__name__"], each.consts) for each in environments]

    def rebuild(self, target_context: Any, payload: tuple[Any, ...]) -> CompileResult:  # noqa: ANN401 - has no types
        """Make a compiled kernel of its parts."""
        defined, (name, kind, (machine_code, llvm_code)), *parts, environments = payload
        target_context.codegen()._engine._defined_symbols.update(defined)  # noqa: SLF001 - as it does with LLVM code
        library = name, kind, (machine_code, _no_code())
        parts = [library, *parts, [_environment(*each) for each in environments]]
        kernel = super().rebuild(target_context, parts)  # type: ignore[no-untyped-call]
        kernel.library._get_module_for_linking = cache(partial(parse_bitcode, llvm_code))  # noqa: SLF001
        return kernel  # type: ignore[no-any-return]


@cache
def _no_code() -> bytes:
    return bytes(parse_assembly("").as_bitcode())


def _environment(name: str, module: str, constants: list[object]) -> Environment:
    environment = lookup_environment(name)  # type: ignore[no-untyped-call]
    if environment is None:
        environment = Environment({"__name__": module})
        environment.consts[:] = constants
        environment.env_name = name
        Environment._memo[name] = environment  # noqa: SLF001 - where numba looks for it
    return environment  # type: ignore[no-any-return]


class _KeptCode(FunctionCache):
    """Machine code on disk that is read without setting up the compiler first, which takes longer than the reading."""

    _impl_class = _Code

    def save_overload(self, sig: object, data: object) -> None:
        """Keep the code for a signature, where the folder can be written."""
        with suppress(OSError):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]

    def load_overload(self, sig: object, target_context: object) -> object:
        """Return the code for a signature, or None, whereupon numba sets up its compiler."""
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]


def forget_older_code(package: Path) -> None:
    """Delete machine code that is older than any kernel of a package, whose modules lie in folders side by side.

    numba sees that a kernel has changed, not that one has which it calls.
    """
    with suppress(OSError):  # other processes do the same; or the folder is read only
        kept = list(package.glob("*/__pycache__/*.nb[ic]"))  # module.kernel-line.py311.nbi
        sources = {path.parents[1] / f"{path.name.partition('.')[0]}.py" for path in kept}
        changed = max((path.stat().st_mtime for path in sources if path.exists()), default=0.0)
        for path in kept:
            if path.stat().st_mtime < changed:
                path.unlink(missing_ok=True)


forget_older_code(Path(__file__).parents[1])
