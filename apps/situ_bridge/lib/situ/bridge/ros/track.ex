defmodule Situ.Bridge.Ros.Track do
  @moduledoc false
  # A track is a map with everything that a reader of bags knows about a topic.
  alias Situ.Bridge.Mcap.{Codec, Extra}

  @doc """
  Returns the track, and with `messages: :apart` also the track of its second stream, of the fields that Situ's types
  have no place for.
  """
  @spec add_extra(map(), :situ | :maps | :apart) :: [map()]
  def add_extra(%{codec: codec, situ: situ} = track, :apart) do
    if Codec.lossy?(codec, situ), do: [track, extra_track(track)], else: [track]
  end

  def add_extra(track, _messages), do: [track]

  defp extra_track(track) do
    %{
      track
      | id: Extra.number(track.id),
        topic: Extra.name(track.topic),
        type: "map",
        codec: Codec.extra(track.codec),
        situ: :map,
        note: nil,
        schema: nil
    }
  end
end
