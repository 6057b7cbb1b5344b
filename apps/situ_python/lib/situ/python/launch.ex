defmodule Situ.Python.Launch do
  @moduledoc false
  # Starts the worker of a component: finds or makes the environment, and waits until Python is ready.
  alias Situ.Error
  alias Situ.Python.{Environment, Program, Worker}

  @doc "Returns the options of a component that has a worker."
  @spec options() :: Situ.Options.schema()
  def options do
    [
      source: [type: :string, required: true],
      class: [type: :string, required: true],
      python: [type: :string, required: true],
      requirements: [type: :any, required: true],
      options: [type: :any, required: true],
      output_types: [type: :any, required: true],
      timeout: [type: :any, required: true],
      start_timeout: [type: :any, required: true],
      memory: [type: :any, required: true],
      shared_memory: [type: :any, required: true],
      batch: [type: :pos_integer, required: true],
      errors: [type: {:in, [:stop, :skip, :restart]}, required: true]
    ]
  end

  @doc "Starts the worker with the options of its component. Returns its process and the version of Python."
  @spec start_worker(map(), Situ.Component.Context.t()) ::
          {:ok, %{worker: pid(), process: non_neg_integer(), version: String.t()}}
          | {:error, Error.t()}
  def start_worker(opts, context) do
    with :ok <- Program.check_source(opts.source),
         {:ok, interpreter} <- find_interpreter(opts, context.path),
         {:ok, worker} <- Worker.start_link(worker_config(opts, interpreter, context)),
         {:ok, process, version} <- await_ready(worker, opts.start_timeout),
         do: {:ok, %{worker: worker, process: process, version: version}}
  end

  defp find_interpreter(%{requirements: nil, python: python}, _path),
    do: Program.find_interpreter(python)

  defp find_interpreter(opts, path) do
    with {:ok, interpreter} <- Program.find_interpreter(opts.python) do
      config = Environment.default_config(path)
      Environment.find_or_create(opts.requirements, interpreter, config)
    end
  end

  defp worker_config(opts, interpreter, context) do
    %{
      path: context.path,
      interpreter: interpreter,
      outputs: opts.output_types,
      timeout: opts.timeout,
      shared_memory: opts.shared_memory,
      start: %{
        "source" => opts.source,
        "class" => opts.class,
        "options" => Map.new(opts.options, fn {key, value} -> {to_string(key), value} end),
        "inputs" => opts |> Map.get(:input_names, [:next]) |> Enum.map(&to_string/1),
        "outputs" => Enum.map(opts.output_types, fn {name, _type} -> to_string(name) end),
        "types" => Enum.map(opts.output_types, fn {_name, type} -> inspect(type) end),
        "on_error" => to_string(opts.errors),
        "memory" => opts.memory,
        "batch" => opts.batch,
        "generates" => not is_map_key(opts, :input_names),
        "shared" => opts.shared_memory
      }
    }
  end

  # The pipeline starts when the component can take messages: loading a model may take long.
  defp await_ready(worker, timeout) do
    receive do
      {:situ_python, ^worker, {:ready, process, version}} -> {:ok, process, version}
      {:situ_python, ^worker, {:ended, error}} -> {:error, error}
      {:EXIT, ^worker, reason} when reason != :normal -> {:error, crash_error(reason)}
    after
      timeout ->
        Process.unlink(worker)
        Process.exit(worker, :kill)
        {:error, slow_start_error(timeout)}
    end
  end

  defp slow_start_error(timeout) do
    Error.new(:timeout, "the Python component did not start within #{timeout} ms",
      why: "importing its modules or its setup took longer",
      fix: "increase start_timeout:"
    )
  end

  @doc "Describes the end of the worker's process in the VM."
  @spec crash_error(term()) :: Error.t()
  def crash_error(reason),
    do:
      Error.new(:python_ended, "the process of the Python worker has failed", why: inspect(reason))
end
