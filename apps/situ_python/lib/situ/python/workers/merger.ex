defmodule Situ.Python.Workers.Merger do
  @moduledoc false
  # Emits the results of workers in the order of the messages: one group of results from each worker in turn. The
  # results of `on_close` follow at the end, in the order of the workers.
  use Situ.Component, options: [workers: [type: {:list, :atom}, required: true]]

  @impl true
  def init(opts) do
    names = opts[:workers]
    queues = Map.new(names, &{&1, :queue.new()})

    {:ok, %{names: names, turn: names, open: names, queues: queues, closing: %{}, last_time: nil}}
  end

  @impl true
  def handle_message(input, %{data: {:closing, results}}, _context, state),
    do: {[], %{state | closing: Map.put(state.closing, input, results)}}

  def handle_message(input, message, _context, state) do
    queues = Map.update!(state.queues, input, &:queue.in(message.data, &1))
    emit_groups(%{state | queues: queues}, [])
  end

  defp emit_groups(%{turn: [input | rest]} = state, groups) do
    case :queue.out(state.queues[input]) do
      {{:value, results}, queue} ->
        state = %{state | queues: %{state.queues | input => queue}, turn: rest ++ [input]}
        emit_groups(state, [results | groups])

      {:empty, _queue} ->
        actions = groups |> Enum.reverse() |> Enum.concat()
        {actions, Enum.reduce(actions, state, &record_time/2)}
    end
  end

  defp record_time({_output, time, _value}, state),
    do: %{state | last_time: max(time, state.last_time || time)}

  @impl true
  def handle_closed(input, _time, _context, state) do
    state = %{state | open: state.open -- [input]}
    if state.open == [], do: emit_closing(state), else: {[], state}
  end

  defp emit_closing(state) do
    results = Enum.flat_map(state.names, &Map.get(state.closing, &1, []))

    Enum.map_reduce(results, state, fn {output, time, value}, state ->
      time = if state.last_time, do: max(time, state.last_time + 1), else: time
      {{output, time, value}, %{state | last_time: time}}
    end)
  end

  @impl true
  def reopen(state), do: %{state | open: state.names}
end
