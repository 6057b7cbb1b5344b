defmodule Situ.Store.SegmentedRecording.Waiting do
  @moduledoc false
  # The processes that wait for new messages of a segmented recording. The index waits for all segments that are being
  # written, and replies to all of them when one has new messages.
  alias Situ.Store.NativeFormat

  # `version` counts the events. `seen`: the known entries of each segment. `asked`: the segments that will send a
  # message.
  defstruct version: 1, seen: %{}, asked: MapSet.new(), waiters: []
  @type t :: %__MODULE__{}
  @type waiter :: {known :: non_neg_integer(), pid(), tag :: term()}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @spec empty?(t()) :: boolean()
  def empty?(%{waiters: waiters}), do: waiters == []

  @doc "Adds a process, or replies immediately. `live` are the segments that are being written."
  @spec add(t(), waiter(), [{integer(), struct()}]) :: t()
  def add(%{version: version} = waiting, {known, pid, tag}, _live) when version > known do
    send(pid, {:situ_store, tag, {:published, version}})
    waiting
  end

  def add(waiting, {_known, pid, tag}, []) do
    send(pid, {:situ_store, tag, {:ended, waiting.version}})
    waiting
  end

  def add(waiting, waiter, live) do
    waiting = %{waiting | waiters: [waiter | waiting.waiters]}
    Enum.reduce(live, waiting, &ask_segment/2)
  end

  defp ask_segment({number, reader}, waiting) do
    if number in waiting.asked do
      waiting
    else
      :ok = NativeFormat.notify(reader, Map.get(waiting.seen, number, 0), self(), number)
      %{waiting | asked: MapSet.put(waiting.asked, number)}
    end
  end

  @doc "Notes the message of a segment."
  @spec handle_event(t(), integer(), {:published | :ended, non_neg_integer()}) :: t()
  def handle_event(waiting, number, {_event, entries}) do
    seen = Map.put(waiting.seen, number, entries)
    asked = MapSet.delete(waiting.asked, number)
    %{waiting | version: waiting.version + 1, seen: seen, asked: asked}
  end

  @doc "Replies to all processes."
  @spec reply(t(), live? :: boolean()) :: t()
  def reply(waiting, live?) do
    event = if live?, do: :published, else: :ended

    for {_, pid, tag} <- waiting.waiters,
        do: send(pid, {:situ_store, tag, {event, waiting.version}})

    %{waiting | waiters: []}
  end
end
