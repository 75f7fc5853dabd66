"""The network of a compensator as C, by emx-onnx-cgen."""

import re
import shutil
import tempfile
from functools import lru_cache
from importlib import resources
from pathlib import Path

from twin.errors import FmuError

from .graph import check_graph, missing_package, parse_network, plain_copy, take_one_sample

PREAMBLE = """\
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("O3", "no-trapping-math") /* vectorises, exp and tanh too; clang does anyway */
#endif
static inline float network_exp(float), network_tanh(float);
static inline float network_max(float, float), network_min(float, float);
static void network_product(const float*, const float*, float*, int, int, int);
static void network_rows(const int8_t*, const uint8_t*, int, int32_t*, int, int);
static void network_steps(const float*, uint8_t*, float*, uint8_t*, int);
static void network_softmax(const float*, float*, int);
#define expf network_exp
#define tanhf network_tanh
#define fmaxf network_max
#define fminf network_min
"""
"""In front of the network's C: what stands for functions of the C library, c/compensator.h."""
_TEMPLATES = tuple(
    f"{name}_op.c.j2" for name in ("matmul", "matmul_integer", "dynamic_quantize_linear", "softmax")
)
"""Ours, in the place of the generator's."""
_EXPORTED = re.compile(
    r"^extern const [^\n]*;\n|^_Bool network_load\(.*?^\}\n", re.MULTILINE | re.DOTALL
)
_OPEN = re.compile(r"^(?=const EMX_UNUSED|void network\()", re.MULTILINE)


class UnsupportedNetworkError(FmuError):
    """The C generator refuses a network that onnxruntime may run."""


@lru_cache(maxsize=2)
def network_source(content: bytes) -> str:
    """C function `network` of an ONNX file; all static, and nothing is allocated in it.

    No text of the file gets into the C: the generator sees a copy of the graph whose names are
    ours, without metadata.

    Raises:
        UnsupportedNetworkError: The generator refuses the network.
        FmuError: The graph cannot stand in an FMU, or emx-onnx-cgen is not installed.
    """
    try:
        import emx_onnx_cgen
        from emx_onnx_cgen.compiler import Compiler, CompilerOptions
        from emx_onnx_cgen.errors import CompilerError
    except ModuleNotFoundError as error:
        raise missing_package(error) from error
    nowhere = Path("network")
    model = parse_network(nowhere, content)
    take_one_sample(model)
    check_graph(nowhere, model)
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as name:
        templates = Path(name, "templates")
        shutil.copytree(Path(emx_onnx_cgen.__file__).parent / "templates", templates)
        for ours in _TEMPLATES:
            (templates / ours).write_text((resources.files("fmus") / "c" / ours).read_text())
        options = CompilerOptions(
            template_dir=templates,
            model_name="network",
            large_temp_threshold_bytes=0,  # temporaries on the stack, none on the heap
            large_weight_threshold=0,  # weights in the binary, none in a file
        )
        try:
            source = Compiler(options).compile(plain_copy(model))
        except CompilerError as error:
            raise UnsupportedNetworkError(f"the C generator refuses the network: {error}") from None
    if "malloc(" in source:
        raise UnsupportedNetworkError("the C generator would allocate memory in each sample")
    return _OPEN.sub("static ", _EXPORTED.sub("", source))
