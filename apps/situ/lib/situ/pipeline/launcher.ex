defmodule Situ.Pipeline.Launcher do
  @moduledoc false
  # Launches a pipeline: a new process builds the graph, replies to its caller and becomes the pipeline's server.
  alias Situ.{Error, Runtime}
  alias Situ.Application.{Directory, CodeReload}
  alias Situ.Graph.Builder
  alias Situ.Lifecycle.Errors
  alias Situ.Pipeline.{Handlers, Server, Settings, State}

  # The result arrives as a separate message, because a short pipeline may have ended before it could be asked.
  def run(spec, opts) do
    reply = make_ref()

    with {:ok, pid} <- launch_process(:start, spec, opts, {:run, reply}) do
      monitor = Process.monitor(pid)

      receive do
        {^reply, result} ->
          Process.demonitor(monitor, [:flush])
          result

        {:DOWN, ^monitor, :process, ^pid, reason} ->
          {:error, Errors.pipeline_crashed(reason)}
      end
    end
  end

  @doc "Starts a pipeline that sends `{reply, result}` to the caller when it has ended, and ends with the caller."
  @spec start_with_reply(Situ.Pipeline.spec(), keyword(), reference()) ::
          {:ok, pid()} | {:error, Error.t()}
  def start_with_reply(spec, opts, reply), do: launch_process(:start, spec, opts, {:run, reply})

  def start_link(spec, opts), do: launch_process(:start_link, spec, opts, :linked)
  def start(spec, opts), do: launch_process(:start, spec, opts, :unlinked)

  def new(settings) do
    ensure_started()

    call = {__MODULE__, :init_empty, [self(), settings]}

    case Runtime.start_process(:start, "Pipeline", call) do
      {:ok, handle} -> handle
      {:error, %Error{} = error} -> raise error
    end
  end

  # A script that runs without mix may not have started the application, and a pipeline would wait for its tables
  # forever.
  defp ensure_started do
    with {:error, reason} <- Application.ensure_all_started(:situ) do
      raise Error.new(:not_started, "the :situ application failed to start: #{inspect(reason)}")
    end
  end

  defp launch_process(how, spec, opts, mode) do
    ensure_started()
    {settings, opts} = Keyword.pop(opts, :pipeline, [])
    {mode, reply} = if is_tuple(mode), do: mode, else: {mode, nil}

    with {:ok, settings} <- Settings.parse(settings, mode, spec),
         {:ok, opts} <- validate_options(spec, opts) do
      origin = if is_atom(spec), do: {spec, opts}
      settings = %{settings | reply: reply && {self(), reply}, origin: origin}
      call = {__MODULE__, :init_it, [self(), spec, opts, settings]}
      normalize_result(Runtime.start_process(how, settings.name, call))
    end
  end

  @doc "Checks options against the schema of the pipeline's module; see `Situ.Pipeline.validate_options/2`."
  @spec validate_options(Situ.Pipeline.spec(), keyword()) ::
          {:ok, keyword()} | {:error, Error.t()}
  def validate_options(spec, opts) do
    cond do
      is_function(spec) ->
        check_known(opts, [], "a function takes no options")

      is_atom(spec) and Code.ensure_loaded?(spec) and function_exported?(spec, :options, 0) ->
        check_known(opts, spec.options(), nil)

      true ->
        {:ok, opts}
    end
  end

  # Settings next to the options, instead of in `pipeline:`, are a common mistake.
  defp check_known(opts, schema, why) do
    with {:error, %{code: :unknown_option} = error} <- Situ.Options.validate(opts, schema) do
      own = Keyword.keys(schema)
      settings = Keyword.keys(Settings.schema())

      case Enum.find(Keyword.keys(opts), &(&1 not in own and &1 in settings)) do
        nil -> {:error, %{error | why: why}}
        key -> {:error, misplaced_setting_error(key, opts[key])}
      end
    end
  end

  defp misplaced_setting_error(key, value) do
    setting = "#{key}: #{inspect(value, limit: 5, printable_limit: 40)}"

    Error.new(:unknown_option, "unknown option #{inspect(key)}",
      why: "#{inspect(key)} is a setting of the pipeline",
      fix: "write pipeline: [#{setting}]"
    )
  end

  # A process that dies during `build` leaves only an exit reason.
  defp normalize_result({:error, %Error{}} = error), do: error
  defp normalize_result({:error, reason}), do: {:error, Errors.pipeline_crashed(reason)}
  defp normalize_result(ok), do: ok

  @doc false
  def init_it(caller, spec, opts, settings) do
    Process.flag(:trap_exit, true)
    state = State.new(settings)
    handle = Builder.open_graph(state.graph)
    add_diagnostics(handle, settings)
    state = %{state | code: {watch_module(settings.origin), nil}}

    case register_and_build(spec, handle, opts, settings) do
      {:ok, result} ->
        graph = Builder.close_graph(handle)
        state = monitor_caller(%{state | handle: handle, graph: graph, result: result}, caller)
        # If the caller has ended in the meantime, the result is of no use.
        unless Process.alive?(caller), do: exit(:normal)
        send(self(), :situ_launch)
        :proc_lib.init_ack({:ok, self()})
        Runtime.enter_loop(Server, state)

      {:error, error} ->
        Handlers.run_abandoned(handle, error)
        :proc_lib.init_ack({:error, error})
        exit(:normal)
    end
  end

  @doc false
  def init_empty(caller, settings) do
    Process.flag(:trap_exit, true)

    with {:ok, settings} <- Settings.parse(settings, :unlinked, nil),
         :ok <- Directory.register_pipeline(settings) do
      state = State.new(settings)
      handle = Builder.open_graph(state.graph)
      add_diagnostics(handle, settings)
      state = monitor_caller(%{state | handle: handle}, caller)
      :proc_lib.init_ack({:ok, handle})
      Runtime.enter_loop(Server, state)
    else
      {:error, error} -> :proc_lib.init_ack({:error, error})
    end
  end

  # Reads the version before the build, so that a version that is loaded during the build counts as new.
  defp watch_module({module, _opts}) do
    Code.ensure_loaded?(module)
    version = CodeReload.code_version(module)
    CodeReload.watch_module(module, version)
    version
  end

  defp watch_module(nil), do: nil

  defp add_diagnostics(_handle, %{diagnostics: false}), do: :ok
  defp add_diagnostics(handle, %{diagnostics: true}), do: Situ.Diagnostics.stream(handle)
  defp add_diagnostics(handle, %{diagnostics: opts}), do: Situ.Diagnostics.stream(handle, opts)

  defp register_and_build(spec, handle, opts, settings) do
    with :ok <- Directory.register_pipeline(settings),
         do: build_graph(spec, handle, opts, settings.name)
  end

  defp build_graph(spec, handle, opts, name) do
    result = if is_function(spec, 1), do: spec.(handle), else: spec.build(handle, opts)
    {:ok, result}
  rescue
    error -> {:error, Errors.build_failed(name, error, __STACKTRACE__)}
  catch
    kind, reason -> {:error, Errors.build_failed(name, {kind, reason}, __STACKTRACE__)}
  end

  defp monitor_caller(%{settings: %{mode: :linked}} = state, _caller), do: state
  defp monitor_caller(state, caller), do: %{state | owner: Process.monitor(caller)}
end
