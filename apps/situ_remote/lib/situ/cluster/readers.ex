defmodule Situ.Cluster.Readers do
  @moduledoc false
  # The subscribers of a publisher: how far each has come, how much it has asked for, and what was read out of the log
  # for one that is behind.
  alias Situ.Cluster.{Chunk, Outgoing}
  alias Situ.Remote.Log
  alias Situ.Remote.Log.Entry

  defstruct by_ref: %{}

  @type t :: %__MODULE__{by_ref: %{term() => map()}}

  @doc "A new one, that has all up to sequence id `from`."
  @spec join(t(), pid(), term(), String.t(), keyword()) :: t()
  def join(%__MODULE__{} = readers, pid, ref, name, opts) do
    reader = %{
      pid: pid,
      part: opts[:reader],
      ref: ref,
      name: name,
      last: Keyword.get(opts, :from, 0),
      demand: 0,
      ahead: [],
      next: nil,
      monitor: Process.monitor(pid)
    }

    %{readers | by_ref: Map.put(readers.by_ref, ref, reader)}
  end

  @spec ask(t(), term(), pos_integer()) :: {:ok, String.t(), t()} | :error
  def ask(%__MODULE__{by_ref: by_ref} = readers, ref, n) do
    case by_ref do
      %{^ref => reader} ->
        reader = %{reader | demand: reader.demand + n}
        {:ok, reader.name, %{readers | by_ref: %{by_ref | ref => reader}}}

      _ ->
        :error
    end
  end

  @spec leave(t(), term()) :: t()
  def leave(%__MODULE__{by_ref: by_ref} = readers, ref) do
    with %{^ref => reader} <- by_ref, do: Process.demonitor(reader.monitor, [:flush])
    %{readers | by_ref: Map.delete(by_ref, ref)}
  end

  @doc "Its process has ended."
  @spec gone(t(), reference()) :: t()
  def gone(%__MODULE__{by_ref: by_ref} = readers, monitor) do
    %{readers | by_ref: Map.reject(by_ref, fn {_, reader} -> reader.monitor == monitor end)}
  end

  @doc "How far each is behind, for people."
  @spec info(t()) :: [map()]
  def info(%__MODULE__{by_ref: by_ref}) do
    for {_, reader} <- by_ref,
        do: %{
          node: node(reader.pid),
          part: reader.part,
          stream: reader.name,
          last: reader.last,
          demand: reader.demand
        }
  end

  @doc "Sends the readers of a stream what they have asked for, as far as it is there."
  @spec serve(t(), Outgoing.t(), Log.t()) :: t()
  def serve(%__MODULE__{by_ref: by_ref} = readers, out, log) do
    by_ref =
      for {ref, reader} <- by_ref,
          reader = if(reader.name == out.name, do: one(reader, out, log), else: reader),
          reader != nil,
          into: %{},
          do: {ref, reader}

    %{readers | by_ref: by_ref}
  end

  defp one(%{last: last} = reader, %{stored: %{last: last, closing: time}} = _out, _log)
       when time != nil do
    Process.demonitor(reader.monitor, [:flush])

    send(
      reader.pid,
      {:"$gen_consumer", {self(), reader.ref}, {:cancel, {:shutdown, {:closed, time}}}}
    )

    nil
  end

  defp one(%{demand: 0} = reader, _out, _log), do: reader

  defp one(%{ahead: []} = reader, out, log) do
    if reader.last >= Outgoing.visible(out) do
      reader
    else
      case Outgoing.recall(out, reader.last + 1) do
        {:ok, messages} -> reader |> give(messages) |> one(out, log)
        :gone -> reader |> fetch(out, log) |> one_fetched(out, log)
      end
    end
  end

  defp one(reader, out, log) do
    {now, later} = Enum.split(reader.ahead, reader.demand)
    %{reader | ahead: later} |> send_on(now) |> one(out, log)
  end

  defp one_fetched(%{ahead: []} = reader, _out, _log), do: reader
  defp one_fetched(reader, out, log), do: one(reader, out, log)

  # The rest stays in the tail.
  defp give(reader, messages), do: send_on(reader, Enum.take(messages, reader.demand))

  defp send_on(reader, messages) do
    send(reader.pid, {:"$gen_consumer", {self(), reader.ref}, messages})
    n = length(messages)
    %{reader | demand: reader.demand - n, last: List.last(messages).sequence_id}
  end

  # The next entry with messages that the reader lacks. After an error of the log the next request tries again.
  defp fetch(%{next: nil} = reader, out, log) do
    case Log.find(log, out.subject, &(Entry.integer(&1, "Last", 0) > reader.last)) do
      {:ok, seq} when is_integer(seq) -> fetch(%{reader | next: seq}, out, log)
      _ -> reader
    end
  end

  defp fetch(reader, out, log) do
    with {:ok, [entry]} <- Log.read(log, out.subject, reader.next, 1),
         {:ok, messages} <- Chunk.messages(entry) do
      reader = %{reader | next: entry.seq + 1}

      case Enum.drop_while(messages, &(&1.sequence_id <= reader.last)) do
        [] when entry.seq < out.seq -> fetch(reader, out, log)
        messages -> %{reader | ahead: messages}
      end
    else
      _ -> %{reader | next: nil}
    end
  end
end
