defmodule Situ.Media.StoredVideo do
  @moduledoc false
  # Compresses images for recordings, and decodes the packets of recordings. `Situ.Store.VideoCoder` calls it.
  # See docs/adr/0196-recordings-store-images-as-video-packets.md.
  @behaviour Situ.Store.VideoCoder

  alias Situ.Media.Recording.Servers
  alias Situ.Media.StoredVideo.{Encoder, EncoderOptions, Images, PacketList}

  @impl true
  defdelegate parse_encoding(encode), to: EncoderOptions, as: :parse

  @impl true
  def encode_stream(stream, {codec, opts}, component),
    do: Situ.via(stream, Encoder, [codec: codec, encoder: opts] ++ component)

  @impl true
  def decode_messages(store, info, ordinal, messages),
    do: call_server(Images, store, info, {ordinal, messages})

  @impl true
  def describe_packets(store, info), do: call_server(PacketList, store, info, :describe)

  # Streams of the same recording have different numbers, and a recording with the same path was created at another
  # time.
  defp call_server(module, store, info, request) do
    print = {info.name, info.id, info.opened}
    source = %{path: store.path, version: :stored, print: print, store: store, info: info}
    Servers.call_server(module, source, request)
  end
end
