defmodule Situ.Infer.Vision.HalfToFloat do
  @moduledoc false
  # Converts the 16-bit float outputs of networks that were exported in half precision to 32-bit floats. ONNX Runtime
  # does the conversion, since there may be a million numbers.
  alias Situ.{Error, Tensor}
  alias Situ.Infer.{Model, Onnx}

  @type t :: Model.t() | nil

  @doc "Builds the conversion for an output of this type and shape; `nil` if none is necessary."
  @spec new({atom(), tuple()}) :: {:ok, t()} | {:error, Error.t()}
  def new({:f16, shape}) do
    free = Tuple.duplicate(nil, tuple_size(shape))
    ports = [inputs: [{"halves", :f16, free}], outputs: [{"floats", :f32, free}]]
    bytes = Onnx.encode(ports ++ [nodes: [{"Cast", ["halves"], ["floats"], [to: 1]}]])
    Model.from_bytes(bytes, "halves", warm_up: 0, sessions: 1)
  end

  def new(_port), do: {:ok, nil}

  @spec to_floats(t(), Tensor.t()) :: {:ok, Tensor.t()} | {:error, Error.t()}
  def to_floats(nil, tensor), do: {:ok, tensor}

  def to_floats(model, tensor) do
    with {:ok, %{"floats" => floats}} <- Model.run(model, %{"halves" => tensor}),
         do: {:ok, floats}
  end
end
