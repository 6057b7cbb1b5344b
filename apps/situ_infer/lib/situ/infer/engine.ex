defmodule Situ.Infer.Engine do
  @moduledoc """
  The engine that runs a model: the seam between `Situ.Infer.Model` and a native library.

  One engine is built in, `Situ.Infer.Engine.Ort` (ONNX Runtime). Another (pure Rust, a remote server) is a module with
  these callbacks, named by the `:engine` option of `Situ.Infer.Model.load/2`.

  Port names, types and shapes are as the model file states them; a dimension of `-1` is free.
  """

  @type handle :: term()
  @type port_spec ::
          {name :: String.t(), Situ.Tensor.element_type() | :unsupported, shape :: tuple()}
  @type loaded :: %{handle: handle(), inputs: [port_spec()], outputs: [port_spec()]}

  @doc """
  Loads a model from its file's bytes. `opts` holds `:threads`, `:sessions`, `:provider` (`:cpu` or `{:cuda, device}`)
  and `:folder`: the folder of the file, in which the files with external data are that it names.
  """
  @callback load(bytes :: binary(), opts :: keyword()) ::
              {:ok, loaded()} | {:error, Situ.Error.t()}

  @doc """
  Runs it once. `where` is `:inline` (on the calling scheduler) or `:dirty` (on one for long work). Answers the
  outputs and the time spent, in nanoseconds.
  """
  @callback run(handle(), inputs :: %{String.t() => Situ.Tensor.t()}, where :: :inline | :dirty) ::
              {:ok, %{String.t() => Situ.Tensor.t()}, nanoseconds :: non_neg_integer()}
              | {:error, Situ.Error.t()}
end
