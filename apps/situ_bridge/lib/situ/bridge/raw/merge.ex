defmodule Situ.Bridge.Raw.Merge do
  @moduledoc false
  # Merges the raw messages of channels in order of their log times. Each channel has a head: the messages that were
  # read and not yet taken. The smallest of the times of the heads is next.
  alias Situ.Bridge.Raw.Reader
  alias Situ.Bridge.{RawChannel, RawMessage}
  alias Situ.Error

  @batch 200

  @enforce_keys [:heads, :from, :to, :skip?]
  defstruct [:heads, :from, :to, :skip?, order: :gb_sets.new(), started?: false]

  @type source :: {reader :: module(), state :: struct(), RawChannel.t()}
  @opaque t :: %__MODULE__{}

  @doc "Prepares the merge; `opts` are `from:`, `to:` (log times or `nil`) and `skip_damage:`."
  @spec start([source()], keyword()) :: t()
  def start(sources, opts) do
    heads = for {source, n} <- Enum.with_index(sources), into: %{}, do: {n, {source, [], 0}}
    %__MODULE__{heads: heads, from: opts[:from], to: opts[:to], skip?: opts[:skip_damage]}
  end

  @doc "Returns the next message, or `nil` at the end."
  @spec take(t()) :: {:ok, RawMessage.t() | nil, t()} | {:error, Error.t()}
  def take(%{started?: false} = merge) do
    merge.heads
    |> Map.keys()
    |> Enum.reduce_while({:ok, %{merge | started?: true}}, fn n, {:ok, merge} ->
      case seek_head(merge, n) do
        {:ok, merge} -> {:cont, {:ok, merge}}
        error -> {:halt, error}
      end
    end)
    |> case do
      {:ok, merge} -> take(merge)
      error -> error
    end
  end

  def take(merge) do
    if :gb_sets.is_empty(merge.order) do
      {:ok, nil, merge}
    else
      {{_time, n}, order} = :gb_sets.take_smallest(merge.order)
      {{_, _, channel} = source, [row | rows], next} = Map.fetch!(merge.heads, n)
      merge = %{merge | order: order, heads: %{merge.heads | n => {source, rows, next}}}
      with {:ok, merge} <- fill_head(merge, n), do: {:ok, build_message(channel, row), merge}
    end
  end

  defp build_message(channel, {log_time, publish_time, sequence, bytes}) do
    %RawMessage{
      channel: channel,
      log_time: log_time,
      publish_time: publish_time,
      sequence: sequence,
      bytes: bytes
    }
  end

  defp seek_head(%{from: nil} = merge, n), do: fill_head(merge, n)

  defp seek_head(merge, n) do
    {{reader, state, channel} = source, [], 0} = merge.heads[n]

    with {:ok, ordinal} <- reader.seek(state, channel, merge.from),
         do: fill_head(%{merge | heads: %{merge.heads | n => {source, [], ordinal}}}, n)
  end

  # Readers move messages with equal times apart, so the first messages may be before `from`.
  defp fill_head(merge, n) do
    case merge.heads[n] do
      {_source, [{time, _, _, _} | _], _next} when merge.to == nil or time <= merge.to ->
        {:ok, %{merge | order: :gb_sets.add({time, n}, merge.order)}}

      {_source, [_ | _], _next} ->
        {:ok, merge}

      {source, [], next} ->
        read_head(merge, n, source, next)
    end
  end

  defp read_head(merge, n, source, ordinal) do
    case read_rows(source, ordinal, @batch, merge.skip?) do
      {:ok, [], ^ordinal} ->
        {:ok, merge}

      {:ok, rows, next} ->
        rows = if merge.from, do: Enum.drop_while(rows, &(elem(&1, 0) < merge.from)), else: rows
        fill_head(%{merge | heads: %{merge.heads | n => {source, rows, next}}}, n)

      error ->
        error
    end
  end

  # To skip damage, messages are read one by one up to the one that cannot be read.
  @spec read_rows(source(), non_neg_integer(), pos_integer(), boolean()) ::
          {:ok, [Reader.row()], non_neg_integer()} | {:error, Error.t()}
  defp read_rows({reader, state, channel} = source, ordinal, limit, skip?) do
    case reader.read(state, channel, ordinal, limit) do
      {:error, %{code: :damaged}} when skip? and limit > 1 -> read_rows(source, ordinal, 1, true)
      {:error, %{code: :damaged}} when skip? -> {:ok, [], min(ordinal + 1, channel.count)}
      result -> result
    end
  end
end
