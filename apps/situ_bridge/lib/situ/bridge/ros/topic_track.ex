defmodule Situ.Bridge.Ros.TopicTrack do
  @moduledoc false
  # Helps readers of bags to build tracks. A track is a map that describes one topic.
  alias Situ.Bridge.Mcap.{Codec, ExtraFields}

  @doc """
  Returns a list with the track. With `messages: :apart`, the list also has a track for the fields that Situ's types do
  not cover.
  """
  @spec add_extra(map(), :situ | :maps | :apart) :: [map()]
  def add_extra(%{codec: codec, situ: situ} = track, :apart) do
    if Codec.lossy?(codec, situ), do: [track, extra_track(track)], else: [track]
  end

  def add_extra(track, _messages), do: [track]

  defp extra_track(track) do
    %{
      track
      | id: ExtraFields.stream_number(track.id),
        topic: ExtraFields.stream_name(track.topic),
        type: "map",
        codec: Codec.extra_codec(track.codec),
        situ: :map,
        note: nil,
        schema: nil
    }
  end
end
