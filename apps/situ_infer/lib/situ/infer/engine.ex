defmodule Situ.Infer.Engine do
  @moduledoc """
  The behaviour of engines, which run models for `Situ.Infer.Model`.

  ONNX Runtime is built in. To add another engine (pure Rust, a remote server), write a module with these callbacks and
  pass it as the `:engine` option of `Situ.Infer.Model.load/2`.

  Port names, types and shapes are those in the model file; a dimension of `-1` is free.
  """

  @type handle :: term()
  @type port_spec ::
          {name :: String.t(), Situ.Tensor.element_type() | :unsupported, shape :: tuple()}
  @type loaded :: %{handle: handle(), inputs: [port_spec()], outputs: [port_spec()]}

  @doc """
  Loads a model from the bytes of its file. `opts` contains `:threads`, `:sessions`, `:provider` (`:cpu` or `{:cuda,
  device}`) and `:folder`, the folder of the model file, in which its external data files are.
  """
  @callback load(bytes :: binary(), opts :: keyword()) ::
              {:ok, loaded()} | {:error, Situ.Error.t()}

  @doc """
  Runs the model once. `where` is `:inline` (on the calling scheduler) or `:dirty` (on a dirty scheduler, for long
  work). Returns the outputs and the time spent, in nanoseconds.
  """
  @callback run(handle(), inputs :: %{String.t() => Situ.Tensor.t()}, where :: :inline | :dirty) ::
              {:ok, %{String.t() => Situ.Tensor.t()}, nanoseconds :: non_neg_integer()}
              | {:error, Situ.Error.t()}
end
