"""A policy as an ONNX graph: normaliser, network, and the mode of its distribution."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from agym_jax.errors import MissingExtraError, UnknownNameError
from agym_jax.policy.networks import OBSERVATION_CLIP
from agym_jax.policy.policy import Policy

OPSET, IR_VERSION = 17, 8  # of 2022: what runtimes on robots read
INPUT, OUTPUT = "observation", "action"
PRECISIONS = ("float64", "float32")
"""Precision of the computation inside the graph. In float32, actions depend on the order of summation, by up to about 1e-5:
JAX's own actions differ by 5e-6 between a single observation and a batch. Some runtimes, such as TensorRT, do not support
float64."""


def import_onnx() -> Any:
    """Import the package ``onnx``.

    Raises:
        MissingExtraError: if it is not installed.
    """
    try:
        import onnx
    except ImportError as error:
        raise MissingExtraError(
            'Writing ONNX needs onnx, which is not installed: pip install "agym_jax[onnx]"'
        ) from error
    return onnx


def build_model(policy: Policy, metadata: Mapping[str, str], precision: str = "float64") -> Any:
    """Build an ``onnx.ModelProto`` that maps observations (batch, n) to actions ``policy(obs)`` (batch, m), both float32.

    Args:
        policy: any policy whose network is described by an ``Architecture``.
        metadata: metadata to store in the file.
        precision: one of ``PRECISIONS``.

    Raises:
        MissingExtraError: if onnx is not installed.
        UnknownNameError: if there is no such precision.
    """
    if precision not in PRECISIONS:
        raise UnknownNameError("precision", precision, PRECISIONS)
    onnx = import_onnx()
    h, arch = onnx.helper, policy.arch
    graph = _Graph(onnx, precision)
    x = graph.node("Sub", graph.widened(INPUT), graph.constant("observation_mean", policy.mean))
    x = graph.node("Div", x, graph.constant("observation_std", policy.std))
    x = graph.clip(x, OBSERVATION_CLIP)
    *hidden, head = _layers(policy)
    for name, layer in hidden:
        x = ACTIVATIONS[arch.activation](graph, graph.dense(x, name, layer))
    head_name, layer = head
    if arch.distribution == "tanh_normal":  # its other outputs are deviations
        layer = {name: np.asarray(w)[..., : arch.action_size] for name, w in layer.items()}
        x = graph.node("Tanh", graph.dense(x, head_name, layer))
    else:
        x = graph.clip(graph.dense(x, head_name, layer), 1.0)
    graph.give(x)
    real = onnx.TensorProto.FLOAT
    model = h.make_model(
        h.make_graph(
            graph.nodes,
            "policy",
            [h.make_tensor_value_info(INPUT, real, ["batch", arch.observation_size])],
            [h.make_tensor_value_info(OUTPUT, real, ["batch", arch.action_size])],
            graph.constants,
        ),
        opset_imports=[h.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="agym_jax",
    )
    h.set_model_props(model, dict(metadata))
    onnx.checker.check_model(model, full_check=True)
    return model


def _layers(policy: Policy) -> list[tuple[str, Mapping[str, Any]]]:
    """Name and weights (``kernel``, ``bias``) of the dense layers, the head last."""
    params, depth = policy.weights["params"], len(policy.arch.policy_hidden)
    if policy.arch.distribution == "tanh_normal":
        return [(name, params[name]) for name in (f"hidden_{i}" for i in range(depth + 1))]
    body = [(f"hidden_{i}", params["MLP_0"][f"hidden_{i}"]) for i in range(depth)]
    return [*body, ("head", params["Dense_0"])]


class _Graph:
    """Nodes and constants, as they are added; constants are kept in float32."""

    def __init__(self, onnx: Any, precision: str):
        self._onnx, self.wide = onnx, precision == "float64"
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def node(self, kind: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        """Add an operation; returns the name of its result."""
        name = output or f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(self._onnx.helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def widened(self, x: str) -> str:
        """What is float32 in the precision that is computed in."""
        return self.node("Cast", x, to=self._onnx.TensorProto.DOUBLE) if self.wide else x

    def give(self, x: str) -> None:
        """Make this the output."""
        self.node("Cast", x, to=self._onnx.TensorProto.FLOAT, output=OUTPUT)

    def constant(self, name: str, value: Any) -> str:
        """Add an array; returns its name."""
        array = np.ascontiguousarray(np.asarray(value, np.float32))
        self.constants.append(self._onnx.numpy_helper.from_array(array, name))
        return self.widened(name)

    def number(self, value: float) -> str:
        """Add a number; returns its name."""
        return self.constant(f"number_{len(self.constants)}", value)

    def dense(self, x: str, name: str, layer: Mapping[str, Any]) -> str:
        """Add a dense layer."""
        kernel, bias = (self.constant(f"{name}_{part}", layer[part]) for part in ("kernel", "bias"))
        return self.node("Gemm", x, kernel, bias)

    def clip(self, x: str, bound: float) -> str:
        """Add limits of +- a bound."""
        return self.node("Clip", x, self.number(-bound), self.number(bound))

    def elu(self, x: str) -> str:
        """Add ELU: ONNX Runtime has it in float32 only."""
        if not self.wide:
            return self.node("Elu", x)
        below = self.node("Exp", self.node("Min", x, self.number(0.0)))
        return self.node("Add", self.node("Relu", x), self.node("Sub", below, self.number(1.0)))

    def swish(self, x: str) -> str:
        """Add x times its logistic function."""
        return self.node("Mul", x, self.node("Sigmoid", x))


ACTIVATIONS: dict[str, Callable[[_Graph, str], str]] = {
    "tanh": lambda graph, x: graph.node("Tanh", x),
    "swish": _Graph.swish,
    "elu": _Graph.elu,
    "relu": lambda graph, x: graph.node("Relu", x),
}
"""As ``networks.ACTIVATIONS``."""
