defmodule Situ.Infer.Vision.Halves do
  @moduledoc false
  # Outputs of 16-bit floats, as networks that were exported in half precision have them, as 32-bit ones. ONNX Runtime
  # does it: there may be a million numbers.
  alias Situ.{Error, Tensor}
  alias Situ.Infer.{Model, Onnx}

  @type t :: Model.t() | nil

  @doc "For an output of this type and shape; `nil` where there is nothing to do."
  @spec new({atom(), tuple()}) :: {:ok, t()} | {:error, Error.t()}
  def new({:f16, shape}) do
    free = Tuple.duplicate(nil, tuple_size(shape))
    ports = [inputs: [{"halves", :f16, free}], outputs: [{"floats", :f32, free}]]
    bytes = Onnx.encode(ports ++ [nodes: [{"Cast", ["halves"], ["floats"], [to: 1]}]])
    Model.from_bytes(bytes, "halves", warm_up: 0, sessions: 1)
  end

  def new(_port), do: {:ok, nil}

  @spec floats(t(), Tensor.t()) :: {:ok, Tensor.t()} | {:error, Error.t()}
  def floats(nil, tensor), do: {:ok, tensor}

  def floats(model, tensor) do
    with {:ok, %{"floats" => floats}} <- Model.run(model, %{"halves" => tensor}),
         do: {:ok, floats}
  end
end
