defmodule Situ.Ortex do
  @moduledoc """
  Runs ONNX models with Ortex, as an engine of `Situ.Infer`.

      {:ok, model} = Situ.Infer.Model.load("person.onnx", engine: Situ.Ortex)

  Situ's own engine is faster to start and needs no package. Use Ortex for its execution providers, such as CoreML and
  DirectML, or to share one build of ONNX Runtime with the rest of an application.

  The providers come from the application's configuration, in order of preference:

      config :situ_ortex, providers: [:coreml, :cpu]

  Without it, `provider: {:cuda, device}` selects CUDA, and everything else the CPU. Ortex decides about threads.
  """
  @behaviour Situ.Infer.Engine

  alias Situ.{Error, TempFolder, Tensor}

  @types %{
    "Float32" => :f32,
    "Float64" => :f64,
    "Float16" => :f16,
    "Bfloat16" => :bf16,
    "Int8" => :s8,
    "Int16" => :s16,
    "Int32" => :s32,
    "Int64" => :s64,
    "Uint8" => :u8,
    "Uint16" => :u16,
    "Uint32" => :u32,
    "Uint64" => :u64,
    "Bool" => :bool
  }

  @impl true
  def load(bytes, opts) do
    # Ortex reads files only.
    TempFolder.with_folder("ortex", fn folder ->
      path = Path.join(folder, "model.onnx")
      File.write!(path, bytes)
      model = Ortex.load(path, providers(opts[:provider]))
      {inputs, outputs} = Ortex.Native.show_session(model.reference)
      ports = %{inputs: Enum.map(inputs, &port_spec/1), outputs: Enum.map(outputs, &port_spec/1)}
      handle = Map.merge(%{model: model}, ports)
      {:ok, Map.put(ports, :handle, handle)}
    end)
  rescue
    error -> {:error, engine_error("cannot load the model", error)}
  end

  @impl true
  def run(%{model: model} = handle, inputs, _where) do
    tensors =
      for {name, _type, _shape} <- handle.inputs, do: Tensor.to_nx(Map.fetch!(inputs, name))

    started = System.monotonic_time(:nanosecond)
    results = Ortex.run(model, List.to_tuple(tensors))
    took = System.monotonic_time(:nanosecond) - started

    outputs =
      for {{name, _type, _shape}, result} <- Enum.zip(handle.outputs, Tuple.to_list(results)),
          into: %{},
          do: {name, result |> Nx.backend_transfer() |> Tensor.from_nx()}

    {:ok, outputs, took}
  rescue
    error -> {:error, engine_error("the model failed", error)}
  end

  # Ortex describes a type by the debug format of Rust: "Tensor { ty: Float32, dimensions: [-1, 3] }".
  @doc false
  def port_spec({name, description, dimensions}) do
    with [_, type] <- Regex.run(~r/\bty: (\w+)/, description),
         true <- is_list(dimensions) do
      {name, Map.get(@types, type, :unsupported), List.to_tuple(dimensions)}
    else
      _no_tensor -> {name, :unsupported, {}}
    end
  end

  defp providers(provider) do
    case {Application.get_env(:situ_ortex, :providers), provider} do
      {nil, {:cuda, _device}} -> [:cuda, :cpu]
      {nil, _cpu} -> [:cpu]
      {providers, _provider} -> providers
    end
  end

  defp engine_error(what, error),
    do: Error.new(:engine_failed, "#{what}: #{Exception.message(error)}", why: "Ortex reports it")
end
