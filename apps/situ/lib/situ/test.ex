defmodule Situ.Test do
  @moduledoc """
  Tests pipelines and components without sleeping: feed messages, move the clock, and check the outputs.

  In a single run, as fast as possible:

      iex> inputs = [left: [{0, 1}, {10, 2}], right: [{0, :a}, {10, :b}]]
      iex> Situ.Test.run(inputs, fn %{left: left, right: right} -> Situ.join(left, right) end)
      {:ok, [{0, {1, :a}}, {10, {2, :b}}]}

  Step by step, if the arrival of messages and the clock matter:

      iex> t = Situ.Test.start([:number], fn %{number: number} -> Situ.map(number, & &1 * 2) end)
      iex> Situ.Test.feed(t, :number, [{0, 1}, {5, 2}])
      iex> Situ.Test.outputs(t)
      [{0, 2}]
      iex> Situ.Test.advance(t, 5)
      iex> Situ.Test.outputs(t)
      [{5, 4}]
      iex> {:ok, report} = Situ.Test.stop(t)
      iex> report.errors
      []

  The function receives a map of input streams and returns a stream, or a list or map of streams; the outputs have the
  same shape. A pipeline under test uses a manual clock that starts at 0 (`start:`), so a message at 5 ns arrives when
  the clock is at 5 ns. The pipeline `p` is the `stream.pipeline` of any stream; for pipelines without inputs the
  function may take the pipeline as a second argument.
  """

  alias Situ.{Clock, Collector, Pipeline, Stream}
  alias Situ.Test.{Input, Idle}

  @enforce_keys [:pipeline, :clock, :inputs, :ref, :shape]
  defstruct [:pipeline, :clock, :inputs, :ref, :shape]

  @type t :: %__MODULE__{}
  @type timed :: {Situ.Time.t(), term()}
  @type build ::
          (%{term() => Stream.t()} -> Collector.streams())
          | (%{term() => Stream.t()}, Pipeline.t() -> Collector.streams())

  @doc """
  Runs a pipeline to its end: each input emits its messages and closes. Returns `{:ok, [{time, data}]}`, in the shape
  that `build` returned, or `{:error, error}`. Times count from 0; `opts` may contain `pipeline:` settings.
  """
  @spec run(keyword([timed()]) | %{term() => [timed()]}, build(), keyword()) ::
          {:ok, term()} | {:error, Situ.Error.t()}
  def run(inputs, build, opts \\ []) do
    settings = Keyword.get(opts, :pipeline, [])

    replay =
      Keyword.merge([interval: {0, :unbounded}, speed: :max], Keyword.get(settings, :replay, []))

    opts = Keyword.put(opts, :pipeline, Keyword.put(settings, :replay, replay))

    spec = fn p ->
      streams =
        Map.new(inputs, fn {key, messages} -> {key, add_closed_input(p, key, messages)} end)

      call_build(build, streams, p)
    end

    with {:ok, collected} <- Collector.collect(spec, opts), do: {:ok, to_timed_pairs(collected)}
  end

  @doc """
  Runs a whole pipeline as fast as possible, and returns the outputs of its named streams.

      iex> build = fn p -> p |> Situ.from_enumerable([{0, 1}, {5, 2}]) |> Situ.map(& &1 * 2, name: "Double") end
      iex> Situ.Test.run_pipeline(build, ["Double"])
      {:ok, %{"Double" => [{0, 2}, {5, 4}]}}

  `opts` are the options of the pipeline, and may contain `pipeline:` settings. Sources that read files keep the times
  of the files.
  """
  @spec run_pipeline(Pipeline.spec(), [String.t()], keyword()) ::
          {:ok, %{String.t() => [timed()]}} | {:error, Situ.Error.t()}
  def run_pipeline(spec, names, opts \\ []) do
    {settings, opts} = Keyword.pop(opts, :pipeline, [])
    replay = Keyword.merge([speed: :max], Keyword.get(settings, :replay, []))

    with {:ok, opts} <- Pipeline.validate_options(spec, opts) do
      build = fn p ->
        if is_atom(spec), do: spec.build(p, opts), else: spec.(p)
        Map.new(names, &{&1, Pipeline.stream(p, &1)})
      end

      settings = Keyword.put(settings, :replay, replay)

      with {:ok, collected} <- Collector.collect(build, pipeline: settings),
           do: {:ok, to_timed_pairs(collected)}
    end
  end

  @doc "Starts a pipeline with these inputs and a manual clock at `start:` (default 0), moved by `advance/2`."
  @spec start([term()], build(), keyword()) :: t()
  def start(inputs, build, opts \\ []) do
    {start, opts} = Keyword.pop(opts, :start, 0)
    clock = Clock.manual(start)
    {me, ref} = {self(), make_ref()}
    settings = Keyword.merge([clock: clock], Keyword.get(opts, :pipeline, []))

    spec = fn p ->
      streams = Map.new(inputs, &{&1, add_fed_input(p, &1, me, ref)})
      outputs = call_build(build, streams, p)

      Enum.each(key_streams(outputs), fn {key, stream} ->
        Collector.attach_sink(stream, me, {ref, key})
      end)

      send(me, {:situ_test_shape, ref, output_shape(outputs)})
    end

    case Pipeline.start(spec, Keyword.put(opts, :pipeline, settings)) do
      {:ok, pid} ->
        await_running(pid)
        test = %__MODULE__{pipeline: pid, clock: clock, inputs: %{}, ref: ref, shape: nil}

        %{
          test
          | inputs: Map.new(inputs, &{&1, await_input(pid, ref, &1)}),
            shape: await_shape(ref)
        }

      {:error, error} ->
        raise error
    end
  end

  @doc "Sends messages `{time, data}` (one or a list) to an input."
  @spec feed(t(), term(), timed() | [timed()]) :: :ok
  def feed(%__MODULE__{} = test, input, messages) do
    send(fetch_input_pid(test, input), {:situ_feed, List.wrap(messages)})
    settle(test)
  end

  @doc "Closes an input, at its last message's time or at `time`."
  @spec close(t(), term(), Situ.Time.t() | nil) :: :ok
  def close(%__MODULE__{} = test, input, time \\ nil) do
    send(fetch_input_pid(test, input), {:situ_close, time})
    settle(test)
  end

  @doc "Moves the clock forward by `duration` ns."
  @spec advance(t(), Situ.Time.duration()) :: :ok
  def advance(%__MODULE__{} = test, duration) do
    Clock.advance(test.clock, duration)
    settle(test)
  end

  @doc "Returns the outputs since the last call, after the pipeline has handled all messages that it was fed."
  @spec outputs(t()) :: term()
  def outputs(%__MODULE__{} = test) do
    settle(test)
    batches = collect_outputs(test.ref, %{})

    case test.shape do
      :only -> Map.get(batches, :only, [])
      {kind, keys} -> keys |> Enum.map(&{&1, Map.get(batches, &1, [])}) |> apply_shape(kind)
    end
  end

  @doc "Stops the pipeline; returns its report, or the error that ended it."
  @spec stop(t()) :: Pipeline.result()
  def stop(%__MODULE__{} = test) do
    case Pipeline.stop(test.pipeline) do
      {:error, %Situ.Error{code: :not_running}} -> Pipeline.await(test.pipeline)
      result -> result
    end
  end

  @doc "Waits until every process of the pipeline has handled its messages."
  @spec settle(t()) :: :ok
  def settle(%__MODULE__{} = test), do: Idle.await_idle(test.pipeline, test.clock)

  defp fetch_input_pid(test, input) do
    Map.get(test.inputs, input) ||
      raise ArgumentError,
            "no input #{inspect(input)}; the inputs are: #{inspect(Map.keys(test.inputs))}"
  end

  # The clock must not move before the pipeline has read it as its start time.
  defp await_running(pid) do
    if Pipeline.state(pid) in [:building, :starting], do: await_running(pid), else: :ok
  end

  defp await_input(pipeline, ref, key) do
    monitor = Process.monitor(pipeline)

    receive do
      {:situ_test_input, ^ref, ^key, pid} ->
        Process.demonitor(monitor, [:flush])
        pid

      {:DOWN, ^monitor, :process, _, reason} ->
        raise "the pipeline did not start: #{inspect(reason)}"
    end
  end

  defp await_shape(ref) do
    receive do
      {:situ_test_shape, ^ref, shape} -> shape
    end
  end

  defp add_closed_input(p, key, messages) do
    Situ.from_enumerable(p, messages, name: "Input #{inspect(key)}")
  end

  defp add_fed_input(p, key, to, ref) do
    p
    |> Pipeline.add(Input, to: to, ref: ref, key: key, name: "Input #{inspect(key)}")
    |> Situ.Node.output(:out)
  end

  defp call_build(build, streams, _p) when is_function(build, 1), do: build.(streams)
  defp call_build(build, streams, p) when is_function(build, 2), do: build.(streams, p)

  defp key_streams(%Stream{} = stream), do: [{:only, stream}]
  defp key_streams(%{} = map), do: Map.to_list(map)

  defp key_streams(list) when is_list(list),
    do: list |> Enum.with_index() |> Enum.map(fn {s, i} -> {i, s} end)

  defp output_shape(%Stream{}), do: :only
  defp output_shape(%{} = map), do: {:map, Map.keys(map)}
  defp output_shape(list), do: {:list, list |> Enum.with_index() |> Enum.map(&elem(&1, 1))}

  defp apply_shape(pairs, :map), do: Map.new(pairs)
  defp apply_shape(pairs, :list), do: Enum.map(pairs, &elem(&1, 1))

  defp collect_outputs(ref, batches) do
    receive do
      {:situ_collected, {^ref, key}, messages} ->
        messages = to_timed_pairs(messages)
        collect_outputs(ref, Map.update(batches, key, messages, &(&1 ++ messages)))
    after
      0 -> batches
    end
  end

  defp to_timed_pairs([%Situ.Message{} | _] = messages),
    do: for(m <- messages, do: {m.originating_time, m.data})

  defp to_timed_pairs([]), do: []
  defp to_timed_pairs(list) when is_list(list), do: Enum.map(list, &to_timed_pairs/1)

  defp to_timed_pairs(%{} = map),
    do: Map.new(map, fn {key, messages} -> {key, to_timed_pairs(messages)} end)
end
