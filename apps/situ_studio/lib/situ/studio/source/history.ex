defmodule Situ.Studio.Source.History do
  @moduledoc """
  Provides a `Situ.Studio.History` as a source. Signals are folded from the messages themselves.
  """
  @behaviour Situ.Studio.Source

  alias Situ.Studio.{History, Gap, StreamInfo}
  alias Situ.Studio.Draw.{Bins, WindowMessages}

  @impl true
  def extent(%History{streams: streams, live: live}) do
    rows = :ets.tab2list(streams)
    firsts = for {_, _, _, _, first, _, _, _} <- rows, first != nil, do: first
    lasts = for {_, _, _, _, _, last, _, _} <- rows, last != nil, do: last
    now = Situ.Time.now()

    {:ok,
     %{
       from: Enum.min(firsts, fn -> now end),
       to: Enum.max(lasts, fn -> now end),
       live: live,
       version: length(rows)
     }}
  rescue
    ArgumentError -> gone_error()
  end

  @impl true
  def streams(%History{streams: streams} = history) do
    infos =
      for {name, type, count, _, first, last, total, kept} <- :ets.tab2list(streams) do
        {shape, keys} = look_inside(history, name, type, last)

        %StreamInfo{
          name: name,
          shape: shape,
          keys: keys,
          type: Situ.Type.to_string(type),
          first: first,
          last: last,
          count: count,
          rate: StreamInfo.mean_rate(kept, first, last),
          bytes: total
        }
      end

    {:ok, Enum.sort_by(infos, & &1.name)}
  rescue
    ArgumentError -> gone_error()
  end

  defp look_inside(history, name, type, last) do
    case {StreamInfo.shape_of_type(type), last} do
      {shape, time} when shape in [:value, :states, :spans] and time != nil ->
        case latest_at(history, name, time) do
          {:ok, message} -> StreamInfo.refine_shape(shape, [message.data])
          _ -> {shape, []}
        end

      {shape, _} ->
        {shape, []}
    end
  end

  @impl true
  def series(history, stream, from, to, bin) do
    with {:ok, messages, _} <- messages(history, stream, from, to, 1_000_000) do
      n = length(messages)

      {before, later} =
        WindowMessages.surrounding_messages({__MODULE__, history}, stream, {from, to}, n)

      points = Enum.flat_map(before ++ messages ++ later, &message_points/1)
      most = max(div(to - from, bin), 2) + length(before) + length(later)
      {points, raw?} = Bins.fold_points(points, bin, most)
      {:ok, points, raw?}
    end
  end

  defp message_points(%{data: %Gap{}, originating_time: time}), do: [Bins.gap(time)]

  defp message_points(%{data: %module{} = data, originating_time: time}) do
    if function_exported?(module, :points, 2), do: module.points(data, time), else: []
  end

  defp message_points(%{data: data, originating_time: time}), do: Bins.value_points(time, data)

  @impl true
  def messages(%History{messages: table}, stream, from, to, limit) do
    spec = [
      {{{stream, :"$1"}, :"$2", :_}, [{:>=, :"$1", from}, {:"=<", :"$1", to}], [:"$2"]}
    ]

    case :ets.select(table, spec, limit + 1) do
      :"$end_of_table" -> {:ok, [], :all}
      {rows, _} when length(rows) > limit -> {:ok, Enum.take(rows, limit), :more}
      {rows, _} -> {:ok, rows, :all}
    end
  rescue
    ArgumentError -> gone_error()
  end

  @impl true
  def marks(history, stream, from, to, limit) do
    with {:ok, messages, more} <- messages(history, stream, from, to, limit) do
      {:ok, for(m <- messages, do: {m.originating_time, Situ.Message.latency(m)}), more}
    end
  end

  @impl true
  def sample(history, stream, from, to, n) do
    with {:ok, messages, _} <- messages(history, stream, from, to, 1_000_000) do
      every = max(div(length(messages), n), 1)
      {:ok, messages |> Enum.with_index(&{&2, &1}) |> Enum.take_every(every)}
    end
  end

  @impl true
  def latest_at(%History{messages: table}, stream, time) do
    lookup_message(table, stream, :ets.prev(table, {stream, time + 1}))
  rescue
    ArgumentError -> gone_error()
  end

  @impl true
  def next_after(%History{messages: table}, stream, time) do
    lookup_message(table, stream, :ets.next(table, {stream, time}))
  rescue
    ArgumentError -> gone_error()
  end

  defp lookup_message(table, stream, {stream, _} = key) do
    case :ets.lookup(table, key) do
      [{_, message, _}] -> {:ok, message}
      [] -> :none
    end
  end

  defp lookup_message(_, _, _), do: :none

  defp gone_error, do: {:error, Situ.Error.new(:gone, "the pipeline no longer exists")}
end
