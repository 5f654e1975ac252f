"""Compiles kernels with numba: parts of programs, and programs made of them.

numba gives every function that it compiles wrappers, optimizes it with all that it calls and turns
it into machine code, although most of our kernels are called by other kernels alone. Here a kernel
is typed and translated once, as a part; a program, which is called from outside, is made of its
parts and optimized as a whole, once.
"""

# numba's classes have no types, or wrong ones.
# pyright: reportAttributeAccessIssue=false, reportIncompatibleMethodOverride=false
# pyright: reportIncompatibleVariableOverride=false, reportCallIssue=false

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import FunctionType
from typing import Any, ClassVar

import llvmlite.binding as llvm
from llvmlite import ir
from numba.core import cgutils, compiler, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.typed_passes import NativeLowering
from numba.core.typing.templates import make_concrete_template

from mjgranular.kernel import lane_types  # noqa: F401  (numba is to know them before it types)
from mjgranular.kernel.fault import FAULT
from mjgranular.kernel.program import Code

OPTIONS: dict[str, Any] = {
    "nopython": True,
    "boundscheck": None,  # as NUMBA_BOUNDSCHECK says
    # IEEE arithmetic (no fastmath): both doors and all platforms are to give the same numbers.
    "error_model": "numpy",
}
"""What numba is told of every kernel."""

_LONG, _DOUBLE = ir.IntType(64), ir.DoubleType()


class _PartLibrary(JITCodeLibrary):
    """The code of one kernel, without that of the kernels that it calls."""

    def add_llvm_module(self, ll_module: Any) -> None:
        self._final_module.link_in(ll_module)

    def finalize(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """With all that it calls: for a kernel that is compiled in numba's own way."""
        if self._shared_module is None:
            module = llvm.parse_assembly("")
            _link(module, self)
            for function in module.functions:
                if not function.is_declaration and function.linkage == llvm.Linkage.external:
                    function.linkage = "linkonce_odr"
            self._shared_module = module
        return self._shared_module


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    """Translates to LLVM's language, and leaves it at that."""

    _name = "part_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        # numba would import the module that the kernel is of: for ever, where the main thread is
        # just importing it, and waits for this one. A function of no module it takes as it is.
        identity = state.func_ir.func_id
        identity.func_qualname = f"{identity.func.__module__}.{identity.func_qualname}"
        identity.func = _of_no_module(identity.func)
        # Kernels make no arrays, and need not count who uses one.
        state.targetctx = state.targetctx.subtarget(enable_nrt=False)
        return super().run_pass(state)


def _of_no_module(function: FunctionType) -> FunctionType:
    """A copy of a function."""
    copy = FunctionType(
        function.__code__,
        function.__globals__,
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    copy.__module__ = None  # pyright: ignore
    return copy


class _Flags(compiler.Flags):
    """What a kernel is compiled with; copies of equal ones are the same object.

    numba compares all flags at every call that it meets, to find what it has compiled for it. That
    is a tenth of the time to compile a program, but for what is identical.
    """

    __slots__ = ()
    _names = hash(tuple(sorted(compiler.Flags.options)))
    _copies: ClassVar[list[_Flags]] = []

    def __hash__(self) -> int:
        return self._names

    def __eq__(self, other: object) -> bool:
        return self is other or super().__eq__(other)

    def copy(self) -> _Flags:
        for copy in self._copies:
            if copy.values() == self.values():
                return copy
        self._copies.append(super().copy())
        return self._copies[-1]


class _PartCompiler(compiler.CompilerBase):
    """numba's compiler for what is called by kernels alone."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.flags = _Flags(self.state.flags)

    def define_pipelines(self) -> list[Any]:
        pipeline = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        pipeline.passes = [
            (_PartLowering if step is NativeLowering else step, text)
            for step, text in pipeline.passes
        ]
        pipeline._finalized = False
        pipeline.finalize()
        return [pipeline]


class Part(CPUDispatcher):
    """A kernel as other kernels see it.

    Args:
        function: the kernel.
        inline: put its code where it is called.
        tell: called with `function` when it is compiled.
    """

    def __init__(
        self, function: Callable[..., Any], *, inline: bool, tell: Callable[..., None]
    ) -> None:
        options = {
            **OPTIONS,
            "forceinline": inline,
            "no_cpython_wrapper": True,
            "no_cfunc_wrapper": True,
        }
        super().__init__(function, targetoptions=options, pipeline_class=_PartCompiler)
        self._tell = tell

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """What a call with these types gives.

        Literals are numbers like others: numba would compile the kernel anew for each.
        """
        signature, args = self._compiler.fold_argument_types(args, kws)
        args = tuple(map(types.unliteral, args))
        found = self.compiled(args).signature
        name = self.py_func.__name__
        return make_concrete_template(name, key=name, signatures=[found]), signature, args, {}

    def compiled(self, args: tuple[Any, ...]) -> Any:
        """What numba made of the kernel for these types of arguments."""
        if args not in self.overloads:
            self._tell(self.py_func)
            with global_compiler_lock:
                result = self._compiler.compile(args, None)
                # By this a call finds it: a function, in numba's own way of compiling.
                result = result._replace(entry_point=object())
                self.targetctx.insert_user_function(
                    result.entry_point, result.fndesc, [result.library]
                )
                self.overloads[args] = result
        return self.overloads[args]

    def compile(self, sig: Any) -> Any:
        return self.compiled(tuple(sig)).entry_point


def _libraries(library: Any, seen: set[int]) -> Iterator[Any]:
    """A library and all that its code calls, each once."""
    if id(library) in seen or library is rtsys.library:
        return
    seen.add(id(library))
    yield library
    if isinstance(library, _PartLibrary):
        for other in library._linking_libraries:
            yield from _libraries(other, seen)


def _link(module: Any, library: Any) -> None:
    for one in _libraries(library, set()):
        one._ensure_finalized()
        part = isinstance(one, _PartLibrary)
        module.link_in(one._final_module if part else one._get_module_for_linking(), preserve=True)


@global_compiler_lock
def build(part: Part, args: tuple[Any, ...], name: str) -> Code:
    """Compiles a program.

    Args:
        part: what it begins with.
        args: numba's types of its arguments: integers and floats.
        name: of the function in C's calling convention; where it takes and gives 64 bits each,
            `name.python` is one that Python can call (METH_FASTCALL).

    Returns:
        The program with these functions.
    """
    part.targetctx.refresh()
    result = part.compiled(args)
    context = result.target_context
    codegen = context.codegen()
    module = llvm.parse_assembly(str(codegen._create_empty_module(name)))
    _link(module, result.library)
    doors = llvm.parse_assembly(cgutils.normalize_ir_text(str(_doors(context, result, name))))
    module.link_in(doors)
    exported = {name, f"{name}.python"}
    for values in (module.functions, module.global_variables):
        for value in values:
            if not value.is_declaration and value.name not in exported:
                value.linkage = "internal"
    module.verify()
    manager, builder = codegen._module_pass_manager()
    manager.run(module, builder)
    needs = [f.name for f in module.functions if f.is_declaration]
    needs += [v.name for v in module.global_variables if v.is_declaration]
    return Code(
        codegen._tm.emit_object(module),
        needs=tuple(sorted(name for name in needs if not name.startswith("llvm."))),
        python=f"{name}.python" in {function.name for function in module.functions},
    )


def _doors(context: Any, result: Any, name: str) -> ir.Module:
    """The functions by which a program is called from outside."""
    description = result.fndesc
    module = context.create_module(name)
    restype, argtypes = description.restype, description.argtypes
    callee = ir.Function(
        module,
        context.call_conv.get_function_type(restype, argtypes),
        description.llvm_func_name,
    )
    answer = context.get_value_type(restype)
    function = ir.Function(
        module, ir.FunctionType(answer, [context.get_value_type(t) for t in argtypes]), name
    )
    builder = ir.IRBuilder(function.append_basic_block())
    status, value = context.call_conv.call_function(
        builder, callee, restype, argtypes, function.args
    )
    if context.enable_boundscheck:  # else kernels raise nothing
        with builder.if_then(status.is_error, likely=False):
            text = context.insert_const_string(module, name)
            fault = ir.Function(module, ir.FunctionType(ir.VoidType(), [text.type]), FAULT)
            builder.call(fault, [text])
            builder.unreachable()
    builder.ret(value)
    if answer == _LONG and all(a.type in (_LONG, _DOUBLE) for a in function.args):
        _python_door(module, function, f"{name}.python")
    return module


def _python_door(module: ir.Module, function: ir.Function, name: str) -> None:
    """A function of Python's for one of integers and floats that gives an integer."""
    object_, long, double = ir.IntType(8).as_pointer(), _LONG, _DOUBLE

    def declare(name: str, result: ir.Type, *arguments: ir.Type) -> ir.Function:
        return ir.Function(module, ir.FunctionType(result, arguments), name)

    door = ir.Function(
        module, ir.FunctionType(object_, [object_, object_.as_pointer(), long]), name
    )
    to_long = declare("PyLong_AsLongLong", long, object_)
    to_double = declare("PyFloat_AsDouble", double, object_)
    from_long = declare("PyLong_FromLongLong", object_, long)
    failed = declare("PyErr_Occurred", object_)
    bad = declare("PyErr_BadArgument", ir.IntType(32))
    builder = ir.IRBuilder(door.append_basic_block())
    with builder.if_then(builder.icmp_signed("!=", door.args[2], long(len(function.args)))):
        builder.call(bad, ())
        builder.ret(object_(None))
    values = []
    for k, argument in enumerate(function.args):
        given = builder.load(builder.gep(door.args[1], [long(k)]))
        values.append(builder.call(to_double if argument.type == double else to_long, [given]))
    with builder.if_then(builder.icmp_unsigned("!=", builder.call(failed, ()), object_(None))):
        builder.ret(object_(None))
    builder.ret(builder.call(from_long, [builder.call(function, values)]))
