defmodule Situ.Python.Source do
  @moduledoc false
  # A source that is a generator in Python. It asks for the next value when its outputs have room.
  #
  # An error ends the pipeline, or starts Python again (`Situ.Python.source`).
  use Situ.Component

  alias Situ.Error
  alias Situ.Python.{Launch, Program, Protocol, Worker}

  # While one value travels, Python produces the next one.
  @asked 2

  @impl true
  def options, do: Launch.options()

  @impl true
  def init(opts), do: {:ok, %{opts: Map.new(opts), worker: nil, last_time: nil}}

  @impl true
  def handle_start(context, state) do
    state = Map.merge(state, state.opts |> Launch.start_worker(context) |> Error.unwrap!())
    ask(@asked, context, state)
    {[], state}
  end

  defp ask(n, context, state) do
    message = %Situ.Message{
      data: nil,
      originating_time: context.now,
      creation_time: context.now,
      sequence_id: 0
    }

    head = Protocol.encode_head(0, message)
    {:ok, value} = Protocol.encode_value(nil)
    Worker.send_messages(state.worker, List.duplicate({head, value}, n))
  end

  @impl true
  def handle_info(
        {:situ_python, worker, {:results, results, _spent}},
        context,
        %{worker: worker} = state
      ),
      do: take_results(results, context, state)

  def handle_info({:situ_python, worker, {:ended, error}}, context, %{worker: worker} = state),
    do: fail(error, context, %{state | worker: nil})

  def handle_info({:EXIT, worker, reason}, context, %{worker: worker} = state)
      when reason != :normal,
      do: fail(Launch.crash_error(reason), context, %{state | worker: nil})

  def handle_info({:continue, {:ask, n}}, context, %{worker: worker} = state)
      when worker != nil do
    ask(n, context, state)
    {[], state}
  end

  def handle_info({:situ_python_failed, error}, _context, _state), do: raise(error)
  def handle_info(_other, _context, state), do: {[], state}

  defp take_results(results, context, state) do
    {emitted, rest} = Enum.split_while(results, &match?({:ok, list} when is_list(list), &1))
    actions = Enum.flat_map(emitted, &elem(&1, 1))
    state = record_time(state, actions)

    case rest do
      [] ->
        {actions ++ [{:continue, {:ask, length(results)}}], state}

      [{:ok, :finished} | _] ->
        {actions ++ [{:complete, state.last_time || context.now}], stop(state)}

      [{:error, error} | _] ->
        {actions, error |> fail(context, stop(state)) |> elem(1)}
    end
  end

  defp record_time(state, actions) do
    Enum.reduce(actions, state, fn {_output, time, _value}, state ->
      %{state | last_time: max(time, state.last_time || time)}
    end)
  end

  # The error is a separate message, so that the results before it are emitted.
  defp fail(error, context, state) do
    send(self(), {:situ_python_failed, %{error | what: "#{context.path} failed: #{error.what}"}})
    {[], state}
  end

  @impl true
  def terminate(_reason, state), do: stop(state)

  defp stop(%{worker: nil} = state), do: state

  defp stop(state) do
    Worker.stop(state.worker)
    %{state | worker: nil}
  end

  @impl true
  def describe(%{worker: nil} = state), do: "#{state.opts.class}, not running"

  def describe(state),
    do: "#{state.opts.class}, #{Program.describe_process(state.process, state.version)}"
end
