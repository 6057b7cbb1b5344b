defmodule Situ.Bridge.Foxglove.StoreChannels do
  @moduledoc false
  # Presents the streams of a recording as Foxglove channels, and reads and encodes their messages.
  alias Situ.Bridge.Mcap.Channel
  alias Situ.Store

  @schema_encodings %{json: "jsonschema", ros1: "ros1msg", cdr: "ros2msg"}
  @encodings %{json: "json", ros1: "ros1", cdr: "cdr"}
  # The limit of messages read from one stream at a time.
  @max_batch 500

  defstruct [:store, :live?, channels: %{}, skipped: %{}]
  @type t :: %__MODULE__{}

  @spec new(Store.t()) :: t()
  def new(store), do: refresh(%__MODULE__{store: store, live?: Store.live?(store)})

  @doc "Adds the streams that have received their first message since the last call."
  @spec refresh(t()) :: t()
  def refresh(source) do
    new =
      for info <- Store.streams(source.store),
          info.count > 0,
          not is_map_key(source.channels, info.id) and not is_map_key(source.skipped, info.id),
          do: {info, build_channel(source.store, info)}

    Enum.reduce(new, %{source | live?: Store.live?(source.store)}, fn
      {info, {:ok, channel}}, source ->
        put_in(source.channels[info.id], {info.name, channel})

      {info, {:error, error}}, source ->
        put_in(source.skipped[info.id], "#{info.name}: #{Exception.message(error)}")
    end)
  end

  defp build_channel(store, info) do
    with {:ok, message} when message != nil <- Store.at(store, info.name, 0),
         do: Channel.new(topic_name(info.name), [encoding: :auto], message.data)
  end

  defp topic_name("/" <> _ = name), do: name
  defp topic_name(name), do: "/" <> String.replace(name, ~r/[. ]/, "/")

  @doc "Returns a channel as it is advertised to clients."
  @spec describe_channel(non_neg_integer(), Channel.t()) :: map()
  def describe_channel(id, channel) do
    {name, _language, schema} = channel.schema

    %{
      id: id,
      topic: channel.topic,
      encoding: @encodings[channel.encoding],
      schemaName: if(name == "", do: "situ.Message", else: name),
      schemaEncoding: @schema_encodings[channel.encoding],
      schema: schema
    }
  end

  @doc "Returns the first and last time of the recording, or zeros if it is empty."
  @spec time_range(t()) :: {Situ.Time.t(), Situ.Time.t()}
  def time_range(source), do: Store.interval(source.store) || {0, 0}

  @doc """
  Returns a channel's messages after `from`, up to `to`, as `{time, {:ok, bytes} | {:error, reason}}`, and whether
  this list is complete.
  """
  @spec messages_between(t(), non_neg_integer(), Situ.Time.t(), Situ.Time.t()) ::
          {[{Situ.Time.t(), {:ok, binary()} | {:error, String.t()}}], all? :: boolean()}
  def messages_between(_source, _id, from, to) when from >= to, do: {[], true}

  def messages_between(source, id, from, to) do
    {name, channel} = Map.fetch!(source.channels, id)

    case Store.read(source.store, name, from: from + 1, to: to, limit: @max_batch) do
      {:ok, messages} ->
        {Enum.map(messages, &encode_message(&1, channel)), length(messages) < @max_batch}

      {:error, error} ->
        {[{to, {:error, Exception.message(error)}}], true}
    end
  end

  @doc "Returns a list with the channel's latest message at or before a time, or an empty list."
  @spec latest_message(t(), non_neg_integer(), Situ.Time.t()) :: [
          {Situ.Time.t(), {:ok, binary()} | {:error, String.t()}}
        ]
  def latest_message(source, id, time) do
    {name, channel} = Map.fetch!(source.channels, id)

    case Store.latest_at(source.store, name, time) do
      {:ok, message} when message != nil -> [encode_message(message, channel)]
      _ -> []
    end
  end

  defp encode_message(message, channel) do
    case Channel.encode(channel, message.data, message.originating_time) do
      {:ok, bytes} -> {message.originating_time, {:ok, bytes}}
      {:error, error} -> {message.originating_time, {:error, Exception.message(error)}}
    end
  end
end
