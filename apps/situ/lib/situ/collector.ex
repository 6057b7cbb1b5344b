defmodule Situ.Collector do
  @moduledoc false
  # Collects streams as lists and as Elixir enumerables, for IEx, scripts and tests. `Situ` documents the functions.

  alias Situ.{Argument, Message, Pipeline, Stream}

  defmodule Sink do
    @moduledoc false
    # Sends the messages it receives to a process, batch by batch.
    use Situ.Component,
      inputs: [in: :any],
      outputs: [],
      options: [to: [type: :pid, required: true], key: [type: :any, required: true]]

    @impl true
    def init(opts), do: {:ok, {opts[:to], opts[:key]}}

    @impl true
    def handle_message(input, message, context, state),
      do: handle_messages(input, [message], context, state)

    @impl true
    def handle_messages(:in, messages, _context, {to, key} = state) do
      send(to, {:situ_collected, key, messages})
      {[], state}
    end
  end

  defmodule BatchHandover do
    @moduledoc false
    # Sends a batch to the reader and waits until the reader wants the next one, so that upstream components run ahead
    # only as far as their demand windows allow. Once the reader has ended, all further messages are dropped.
    use Situ.Component,
      inputs: [in: :any],
      outputs: [],
      options: [to: [type: :pid, required: true], ref: [type: :any, required: true]]

    @impl true
    def init(opts), do: {:ok, {opts[:to], opts[:ref], :reading}}

    @impl true
    def handle_start(_context, {to, _ref, _mode} = state) do
      Process.monitor(to)
      {[], state}
    end

    @impl true
    def handle_message(input, message, context, state),
      do: handle_messages(input, [message], context, state)

    @impl true
    def handle_messages(:in, _messages, _context, {_, _, :discarding} = state), do: {[], state}

    def handle_messages(:in, messages, context, {to, ref, :reading} = state) do
      send(to, {:situ_gate, ref, self(), messages})

      receive do
        {:situ_gate, ^ref, :more} -> {[], state}
        {:situ_gate, ^ref, :enough} -> {[], {to, ref, :discarding}}
        {:DOWN, _, :process, ^to, _} -> stop_pipeline(context, state)
      end
    end

    @impl true
    def handle_info({:situ_gate, ref, :enough}, _context, {to, ref, _}),
      do: {[], {to, ref, :discarding}}

    def handle_info({:DOWN, _, :process, to, _}, context, {to, _, _} = state),
      do: stop_pipeline(context, state)

    def handle_info(_other, _context, state), do: {[], state}

    defp stop_pipeline(context, {to, ref, _mode}) do
      Situ.Pipeline.stop(context.pipeline)
      {[], {to, ref, :discarding}}
    end
  end

  @type streams :: Stream.t() | [Stream.t()] | %{term() => Stream.t()} | keyword(Stream.t())

  def collect(build, opts) when is_function(build, 1) do
    ref = make_ref()
    me = self()

    spec = fn p ->
      streams = build.(p)
      Enum.each(key_streams(streams), fn {key, stream} -> attach_sink(stream, me, {ref, key}) end)
      result_shape(streams)
    end

    result = Pipeline.run(spec, opts)
    messages = drain_collected(ref, %{})
    with {:ok, report} <- result, do: {:ok, fill_shape(report.result, messages)}
  end

  def collect(other, _opts), do: refuse_build!(other, "collect")

  def to_list(build, opts) when is_function(build, 1) do
    {times?, opts} = Keyword.pop(opts, :times, false)

    case collect(build, opts) do
      {:ok, collected} -> messages_to_data(collected, times?)
      {:error, error} -> raise error
    end
  end

  def to_list(other, _opts), do: refuse_build!(other, "to_list")

  def to_stream(build, opts) when is_function(build, 1) do
    {messages?, opts} = Keyword.pop(opts, :messages, false)

    Elixir.Stream.resource(
      fn -> start_reading(build, opts) end,
      &read_batch(&1, messages?),
      &stop_reading/1
    )
  end

  def to_stream(other, _opts), do: refuse_build!(other, "to_stream")

  @spec refuse_build!(term(), String.t()) :: no_return()
  defp refuse_build!(other, name) do
    example = "Situ.#{name}(fn p -> Situ.from_enumerable(p, 1..9, every: 1) end)"
    Argument.raise_invalid!(other, :build, example)
  end

  @spec attach_sink(Stream.t(), pid(), term()) :: :ok
  def attach_sink(%Stream{} = stream, to, key) do
    node = Pipeline.add(stream.pipeline, Sink, to: to, key: key, default_name: "Collect")
    Pipeline.connect(stream, node, :in, [])
  end

  defp key_streams(%Stream{} = stream), do: [{:only, stream}]
  defp key_streams(%{} = map), do: Map.to_list(map)

  defp key_streams(list) when is_list(list) do
    if Keyword.keyword?(list),
      do: list,
      else: list |> Enum.with_index() |> Enum.map(fn {stream, i} -> {i, stream} end)
  end

  defp key_streams(other) do
    raise ArgumentError,
          "expected a stream, or a list or map of streams, got: #{inspect(other, limit: 5)}"
  end

  defp result_shape(%Stream{}), do: :only
  defp result_shape(%{} = map), do: {:map, Map.keys(map)}

  defp result_shape(list),
    do:
      if(Keyword.keyword?(list), do: {:keyword, Keyword.keys(list)}, else: {:list, length(list)})

  defp fill_shape(:only, messages), do: Map.get(messages, :only, [])
  defp fill_shape({:map, keys}, messages), do: Map.new(keys, &{&1, Map.get(messages, &1, [])})

  defp fill_shape({:keyword, keys}, messages),
    do: Enum.map(keys, &{&1, Map.get(messages, &1, [])})

  defp fill_shape({:list, 0}, _messages), do: []
  defp fill_shape({:list, n}, messages), do: Enum.map(0..(n - 1), &Map.get(messages, &1, []))

  defp messages_to_data([%Message{} | _] = messages, times?),
    do: Enum.map(messages, &message_to_data(&1, times?))

  defp messages_to_data(%{} = map, times?),
    do: Map.new(map, fn {k, v} -> {k, messages_to_data(v, times?)} end)

  defp messages_to_data(list, times?) when is_list(list) do
    Enum.map(list, fn
      {key, messages} -> {key, messages_to_data(messages, times?)}
      messages -> messages_to_data(messages, times?)
    end)
  end

  defp message_to_data(message, true), do: {message.originating_time, message.data}
  defp message_to_data(message, false), do: message.data

  defp drain_collected(ref, messages) do
    receive do
      {:situ_collected, {^ref, key}, batch} ->
        drain_collected(ref, Map.update(messages, key, [batch], &[batch | &1]))
    after
      0 ->
        Map.new(messages, fn {key, batches} ->
          {key, batches |> Enum.reverse() |> Enum.concat()}
        end)
    end
  end

  # Lazy reading: a gate at the end of the pipeline delivers one batch at a time.

  defp start_reading(build, opts) do
    {me, ref} = {self(), make_ref()}
    settings = Keyword.put_new(Keyword.get(opts, :pipeline, []), :replay, speed: :max)

    spec = fn p ->
      stream = build.(p)
      node = Pipeline.add(p, BatchHandover, to: me, ref: ref, default_name: "Enumerable")
      Pipeline.connect(stream, node, :in, [])
    end

    case Pipeline.start(spec, Keyword.put(opts, :pipeline, settings)) do
      {:ok, pid} -> %{pipeline: pid, ref: ref, monitor: Process.monitor(pid), gate: nil}
      {:error, error} -> raise error
    end
  end

  defp read_batch(%{ref: ref, monitor: monitor} = state, messages?) do
    receive do
      {:situ_gate, ^ref, gate, messages} ->
        send(gate, {:situ_gate, ref, :more})
        {if(messages?, do: messages, else: Enum.map(messages, & &1.data)), %{state | gate: gate}}

      {:DOWN, ^monitor, :process, pid, _reason} ->
        finish_reading(Pipeline.await(pid), state)
    end
  end

  defp finish_reading({:error, %Situ.Error{code: code} = error}, _state)
       when code != :not_running,
       do: raise(error)

  defp finish_reading(_result, state), do: {:halt, state}

  defp stop_reading(%{pipeline: pipeline, ref: ref, monitor: monitor, gate: gate}) do
    if gate != nil, do: send(gate, {:situ_gate, ref, :enough})

    # The reader needs no more data, so sources stop immediately.
    case Situ.Pipeline.stop(pipeline, catch_up: 0, timeout: 5_000) do
      {:error, %Situ.Error{code: :timeout}} -> Process.exit(pipeline, :kill)
      _ -> :ok
    end

    Process.demonitor(monitor, [:flush])
    flush_batches(ref)
  end

  defp flush_batches(ref) do
    receive do
      {:situ_gate, ^ref, _, _} -> flush_batches(ref)
    after
      0 -> :ok
    end
  end
end
