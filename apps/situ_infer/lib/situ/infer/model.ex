defmodule Situ.Infer.Model do
  @moduledoc """
  A neural network loaded from an ONNX file, with named input tensors and named output tensors.

      iex> alias Situ.{Infer.Model, Tensor}
      iex> path = Model.bundled_path("silero_vad.onnx")
      iex> {:ok, model} = Model.load(path, inputs: %{"input" => {:f32, {nil, nil}}})
      iex> inputs = %{
      ...>   "input" => Tensor.zeros(:f32, {1, 576}),
      ...>   "state" => Tensor.zeros(:f32, {2, 1, 128}),
      ...>   "sr" => Tensor.from_list([16_000], :s64, {})
      ...> }
      iex> {:ok, %{"output" => probability}} = Model.run(model, inputs)
      iex> probability.shape
      {1, 1}

  A model is loaded once and may be used by several processes at the same time. With `load_shared/2`, components that
  name the same file and options share one copy, which is released when the last of them ends.

  The model's ports are checked **at load**. `:inputs` and `:outputs` give their types and shapes; `nil` means any size,
  and a size that the file leaves free matches anything. A wrong file therefore stops a pipeline before its first
  message, with an error that shows both shapes.

  Weights may be in separate files next to the model file (ONNX's external data, usual above 2 GB).

  ## Errors

  `:no_onnxruntime` (the library is missing; the load can be retried), `:no_model_file`, `:bad_model` (truncated or
  corrupt), `:model_shape` (inputs or outputs other than the expected ones), `:no_provider`, `:bad_tensor`,
  `:model_failed`.

  ## Events

  `[:situ, :infer, :load]` with the `duration` (ns) and the name of the `model`; `run_stats/1` returns the run times.
  """

  @schema [
    engine: [
      type: {:or, [{:in, [:onnxruntime]}, :module]},
      default: :onnxruntime,
      doc: "The engine that runs the model: ONNX Runtime, or a `Situ.Infer.Engine`."
    ],
    provider: [
      type: {:or, [{:in, [:cpu]}, {:tuple, [{:in, [:cuda]}, :non_neg_integer]}]},
      default: :cpu,
      doc: "`:cpu`, or `{:cuda, device}` if the library was built with CUDA."
    ],
    threads: [
      type: :pos_integer,
      default: 1,
      doc:
        "The number of threads in one run. One is best while several components share the cores."
    ],
    sessions: [
      type: {:optional, :pos_integer},
      default: nil,
      doc:
        "How many runs may be in progress at a time; each needs the network's memory. `nil`: as many as cores."
    ],
    schedule: [
      type: {:in, [:auto, :inline, :dirty]},
      default: :auto,
      doc:
        "The scheduler of the runs. `:auto` measures during warm-up: inline below 0.3 ms, otherwise a dirty scheduler."
    ],
    warm_up: [
      type: :non_neg_integer,
      default: 3,
      doc:
        "The number of warm-up runs. They set free sizes to 1; a model that rejects that is not warmed up."
    ],
    example: [
      type: :map,
      default: %{},
      doc: "Inputs for the warm-up, `%{\"name\" => tensor}`; all other inputs are zeros."
    ],
    inputs: [
      type: :map,
      default: %{},
      doc: "The inputs that the file must have: `%{\"name\" => {type, shape}}`."
    ],
    outputs: [
      type: :map,
      default: %{},
      doc: "The outputs that the file must have, in the same form."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  alias Situ.{Error, Tensor}
  alias Situ.Infer.Model.PortCheck

  # A longer run would delay other processes; see the scheduler rules in the native guide.
  @inline_limit_ns 300_000

  @enforce_keys [:name, :engine, :handle, :inputs, :outputs, :where, :counters]
  defstruct [:name, :engine, :handle, :inputs, :outputs, :where, :counters]

  @type t :: %__MODULE__{
          name: String.t(),
          engine: module(),
          handle: term(),
          inputs: %{String.t() => {Tensor.element_type(), tuple()}},
          outputs: %{String.t() => {Tensor.element_type(), tuple()}},
          where: :inline | :dirty,
          counters: :counters.counters_ref()
        }

  @doc "Loads, checks and warms up the model in the file at `path`."
  @spec load(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load(path, opts \\ []) do
    with {:ok, bytes} <- read_file(path), do: from_bytes(bytes, path, opts)
  end

  @doc """
  Like `load/2`, but from the bytes of an ONNX file. Errors and statistics name the model by `path`, and its external
  data files are expected in that folder.
  """
  @spec from_bytes(binary(), Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def from_bytes(bytes, path, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         opts = Keyword.update!(opts, :sessions, &(&1 || System.schedulers_online())),
         started = System.monotonic_time(:nanosecond),
         settings = [{:folder, path |> Path.expand() |> Path.dirname()} | opts],
         {:ok, loaded} <- with_path(engine_module(opts).load(bytes, settings), path),
         model = build_model(path, opts, loaded),
         :ok <- PortCheck.check_numeric(model.inputs, path),
         :ok <- PortCheck.check_ports(model.inputs, opts[:inputs], "input", path),
         :ok <- PortCheck.check_ports(model.outputs, opts[:outputs], "output", path),
         {:ok, model} <- warm_up(model, opts) do
      duration = System.monotonic_time(:nanosecond) - started
      Situ.Telemetry.execute([:situ, :infer, :load], %{duration: duration}, %{model: model.name})
      {:ok, model}
    end
  end

  @doc """
  Like `load/2`, but every caller with the same file and options gets the same model.

  A model is kept while a process that requested it is alive, and for a minute after that. Beyond 512 MB of model files
  (`config :situ_infer, shared_bytes: n`) the least recently requested model is no longer shared; processes that have it
  keep it.
  """
  @spec load_shared(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load_shared(path, opts \\ []) do
    case File.stat(path, time: :posix) do
      {:ok, stat} ->
        key = {Path.expand(path), stat.size, stat.mtime, opts}
        Situ.Infer.ModelCache.fetch(key, stat.size, fn -> load(path, opts) end)

      {:error, _} ->
        load(path, opts)
    end
  end

  @doc """
  Runs the model on `%{"input name" => tensor}`, which must contain all inputs.

  Returns `{:ok, %{"output name" => tensor}}`, or `:bad_tensor` with the input, its expected type and shape, and the
  actual ones.
  """
  @spec run(t(), %{String.t() => Tensor.t()}) ::
          {:ok, %{String.t() => Tensor.t()}} | {:error, Error.t()}
  def run(%__MODULE__{} = model, inputs) when is_map(inputs) do
    with :ok <- check_inputs(model, inputs),
         :ok <- check_names(model, inputs),
         do: run_engine(model, inputs)
  end

  @doc """
  Runs several inputs in one run by stacking them along the first dimension if the file leaves that free, and otherwise
  one by one.

  The results are in the order of the inputs, each with its own rows.
  """
  @spec run_batch(t(), [%{String.t() => Tensor.t()}]) ::
          {:ok, [%{String.t() => Tensor.t()}]} | {:error, Error.t()}
  def run_batch(%__MODULE__{}, []), do: {:ok, []}

  def run_batch(%__MODULE__{} = model, batch) do
    if stackable?(model), do: run_stacked(model, batch), else: run_each(model, batch)
  end

  @doc """
  Returns how often the model ran and how long that took: `%{runs: n, mean_ns: ns, last_ns: ns, max_ns: ns, where:
  :inline | :dirty}`.
  """
  @spec run_stats(t()) :: map()
  def run_stats(%__MODULE__{counters: c, where: where}) do
    runs = :counters.get(c, 1)
    mean = if runs > 0, do: div(:counters.get(c, 2), runs), else: 0
    last = :counters.get(c, 3)
    %{runs: runs, mean_ns: mean, last_ns: last, max_ns: :counters.get(c, 4), where: where}
  end

  @doc "Describes the model in one line, for diagnostics; `nil` is a model that is not loaded yet."
  @spec describe_runs(t() | nil) :: String.t()
  def describe_runs(nil), do: "not started"

  def describe_runs(%__MODULE__{} = model) do
    stats = run_stats(model)

    "#{model.name}: #{stats.runs} runs, mean #{Situ.Time.format_duration(stats.mean_ns)}, #{stats.where}"
  end

  @doc "Returns the path of a model file bundled with this app (`\"silero_vad.onnx\"`)."
  @spec bundled_path(String.t()) :: Path.t()
  def bundled_path(file), do: Path.join([to_string(:code.priv_dir(:situ_infer)), "models", file])

  defp read_file(path) do
    case File.read(path) do
      {:ok, bytes} ->
        {:ok, bytes}

      {:error, reason} ->
        {:error,
         Error.new(:no_model_file, "cannot read the model #{inspect(path)}",
           why: to_string(:file.format_error(reason)),
           fix: "check the path"
         )}
    end
  end

  defp with_path({:error, %Error{code: :bad_model} = error}, path),
    do:
      {:error, %{error | meta: Map.put(error.meta, :path, path), what: "#{error.what} (#{path})"}}

  defp with_path(result, _path), do: result

  defp engine_module(opts),
    do: if(opts[:engine] == :onnxruntime, do: Situ.Infer.Engine.Ort, else: opts[:engine])

  defp build_model(path, opts, loaded) do
    %__MODULE__{
      name: Path.basename(path, ".onnx"),
      engine: engine_module(opts),
      handle: loaded.handle,
      inputs: Map.new(loaded.inputs, fn {name, type, shape} -> {name, {type, shape}} end),
      outputs: Map.new(loaded.outputs, fn {name, type, shape} -> {name, {type, shape}} end),
      where: if(opts[:schedule] == :inline, do: :inline, else: :dirty),
      counters: :counters.new(4, [])
    }
  end

  defp warm_up(model, opts) do
    example =
      Map.new(model.inputs, fn {name, {type, shape}} ->
        {name, Map.get_lazy(opts[:example], name, fn -> zero_tensor(type, shape, opts, name) end)}
      end)

    with {:ok, times} <- time_runs(model, example, opts[:warm_up], []) do
      {:ok, %{model | where: choose_scheduler(opts[:schedule], times)}}
    else
      # Setting free sizes to 1 is a guess, so the guess may have caused the failure rather than the model.
      {:error, %Error{code: :model_failed} = error} ->
        if guessed_sizes?(model, opts),
          do: {:ok, model},
          else: {:error, warm_up_error(error, model, example)}

      {:error, error} ->
        {:error, error}
    end
  end

  defp time_runs(_model, _example, 0, times), do: {:ok, times}

  defp time_runs(model, example, n, times) do
    with {:ok, _, ns} <- model.engine.run(model.handle, example, :dirty),
         do: time_runs(model, example, n - 1, [ns | times])
  end

  defp guessed_sizes?(model, opts) do
    Enum.any?(model.inputs, fn {name, {_, shape}} ->
      not is_map_key(opts[:example], name) and -1 in expected_sizes(shape, opts, name)
    end)
  end

  defp warm_up_error(error, model, example) do
    given =
      Enum.map_join(example, ", ", fn {name, t} ->
        "#{name}: #{PortCheck.format_port({t.type, t.shape})}"
      end)

    Error.new(
      :model_failed,
      "model #{model.name} does not run on zeros (#{given}): #{error.what}",
      why:
        "the file contains a different kind of model, or its inputs need particular values or sizes",
      fix: "use the model file this component is made for, or set example: inputs or warm_up: 0"
    )
  end

  defp zero_tensor(type, shape, opts, name) do
    sizes = for size <- expected_sizes(shape, opts, name), do: if(size == -1, do: 1, else: size)
    Tensor.zeros(type, List.to_tuple(sizes))
  end

  # The caller's shape of a port may fix a dimension that the file leaves free.
  defp expected_sizes(shape, opts, name) do
    case opts[:inputs] do
      %{^name => {_, wanted}} ->
        Enum.zip_with(Tuple.to_list(shape), Tuple.to_list(wanted), &known_size/2)

      _ ->
        Tuple.to_list(shape)
    end
  end

  defp known_size(have, wanted), do: if(have > 0, do: have, else: wanted || -1)

  defp choose_scheduler(:inline, _times), do: :inline
  defp choose_scheduler(:dirty, _times), do: :dirty
  defp choose_scheduler(:auto, []), do: :dirty

  defp choose_scheduler(:auto, times),
    do: if(Enum.min(times) < @inline_limit_ns, do: :inline, else: :dirty)

  defp check_inputs(model, inputs) do
    Enum.find_value(model.inputs, :ok, fn {name, {type, shape}} ->
      case inputs do
        %{^name => %Tensor{type: ^type, shape: given} = tensor} ->
          if PortCheck.shape_matches?(shape, given),
            do: check_size(model, name, tensor),
            else: bad_input(model, name, {type, shape}, {type, given})

        %{^name => %Tensor{} = t} ->
          bad_input(model, name, {type, shape}, {t.type, t.shape})

        _ ->
          {:error,
           Error.new(:bad_tensor, "model #{model.name}: input #{inspect(name)} is missing",
             fix:
               "give a tensor for each of #{Enum.map_join(Map.keys(model.inputs), ", ", &inspect/1)}"
           )}
      end
    end)
  end

  defp check_names(model, inputs) when map_size(inputs) == map_size(model.inputs), do: :ok

  defp check_names(model, inputs) do
    [name | _] = Map.keys(inputs) -- Map.keys(model.inputs)

    {:error,
     Error.new(:bad_tensor, "model #{model.name} has no input #{inspect(name)}",
       fix: "its inputs are #{Enum.map_join(Map.keys(model.inputs), ", ", &inspect/1)}"
     )}
  end

  # Checks that the tensor has as many bytes as its shape needs; `nil` means that it does.
  defp check_size(model, name, tensor) do
    _ = Tensor.reshape(tensor, tensor.shape)
    nil
  rescue
    error in ArgumentError ->
      {:error,
       Error.new(
         :bad_tensor,
         "model #{model.name}: the tensor for input #{inspect(name)} is invalid",
         why: error.message,
         fix: "build tensors with Situ.Tensor.new/3"
       )}
  end

  defp bad_input(model, name, wanted, given) do
    {:error,
     Error.new(
       :bad_tensor,
       "model #{model.name}: input #{inspect(name)} takes #{PortCheck.format_port(wanted)}, " <>
         "got #{PortCheck.format_port(given)}",
       fix: "give a tensor of that type and shape (-1 is any size), or use another model"
     )}
  end

  defp run_engine(model, inputs) do
    with {:ok, outputs, ns} <- model.engine.run(model.handle, inputs, model.where) do
      :counters.add(model.counters, 1, 1)
      :counters.add(model.counters, 2, ns)
      :counters.put(model.counters, 3, ns)
      if ns > :counters.get(model.counters, 4), do: :counters.put(model.counters, 4, ns)
      {:ok, outputs}
    end
  end

  defp stackable?(model) do
    ports = Map.values(model.inputs) ++ Map.values(model.outputs)
    Enum.all?(ports, fn {_, shape} -> tuple_size(shape) > 0 and elem(shape, 0) == -1 end)
  end

  defp run_stacked(model, batch) do
    names = Map.keys(model.inputs)

    checks = Enum.map(batch, &check_inputs(model, &1))

    with :ok <- Enum.find(checks, :ok, &(&1 != :ok)) do
      sizes = Enum.map(batch, &elem(Map.fetch!(&1, hd(names)).shape, 0))

      stacked =
        Map.new(names, fn n -> {n, Tensor.concat(Enum.map(batch, &Map.fetch!(&1, n)))} end)

      with {:ok, outputs} <- run_engine(model, stacked), do: {:ok, split_outputs(outputs, sizes)}
    end
  end

  defp split_outputs(outputs, sizes) do
    columns = for {name, t} <- outputs, do: Enum.map(Tensor.split_rows(t, sizes), &{name, &1})
    Enum.zip_with(columns, &Map.new/1)
  end

  defp run_each(model, batch), do: Error.map_ok(batch, &run(model, &1))
end
