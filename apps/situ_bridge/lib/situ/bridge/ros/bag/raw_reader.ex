defmodule Situ.Bridge.Ros.Bag.RawReader do
  @moduledoc false
  # Reads the messages of a bag without decoding them. Each connection is a channel.
  @behaviour Situ.Bridge.Raw.Reader
  alias Situ.Bridge.RawChannel
  alias Situ.Bridge.Ros.Bag.MessageReader
  alias Situ.Bridge.Ros.MessageIndex

  @impl true
  def list_channels(state) do
    names = stream_names(state)

    {:ok,
     for {number, connection} <- Enum.sort(state.contents.connections) do
       rows = state.contents.positions |> Map.get(number, []) |> Enum.concat()

       %RawChannel{
         id: number,
         topic: connection.topic,
         stream: names[{connection.topic, connection.type}],
         encoding: "ros1",
         schema: {connection.type, "ros1msg", connection.definition},
         metadata: connection.header,
         count: length(rows),
         places: MessageIndex.pack(rows)
       }
     end}
  end

  # Connections with the same topic and type are one stream.
  defp stream_names(state) do
    for %{id: id, name: name} <- state.streams, track = state.tracks[id], into: %{} do
      {{track.topic, track.type}, name}
    end
  end

  @impl true
  def seek(_state, channel, time), do: {:ok, MessageIndex.seek(channel.places, time)}

  @impl true
  def read(state, channel, ordinal, limit) do
    places = MessageIndex.slice(channel.places, ordinal, :unbounded, limit)

    with {:ok, messages} <- MessageReader.read_messages(state.path, state.size, places) do
      rows =
        for {{packed_time, _, _}, {recorded, bytes}} <- messages,
            time = recorded || packed_time,
            do: {time, time, 0, bytes}

      {:ok, rows, ordinal + length(rows)}
    end
  end

  @impl true
  def read_extras(_state), do: {:ok, [], []}
end
