defmodule Situ.Recording.CodedVideo do
  @moduledoc """
  The compressed images of a stream, for a program that decodes them by itself, such as the studio's page.

  `fetch/2` describes the stream, and `read_packets/4` returns the bytes of its packets. Stores have them for streams
  that were recorded with `encode:` (`Situ.Store.write/4`). Other recordings offer them if their module implements the
  callbacks `coded_video` and `coded_packets` of `Situ.Recording`; `Situ.Media` does for MP4, MOV, MKV, WebM and AVI
  files.

    * `codec`: the codec as WebCodecs names it (`"avc1.640028"`, `"vp8"`, `"vp09.00.62.08"`, `"av01.0.08M.08"`,
      `"hvc1.1.6.L93.B0"`), or `"jpeg"` or `"png"` for images that do not depend on each other
    * `description`: the setup data of the decoder (such as an `avcC` record), or `""`
    * `width`, `height`: the size of the images in pixels, before `rotation`
    * `rotation`: by how many degrees (0, 90, 180 or 270) the images are turned clockwise to be shown
    * `color`: the color matrix that the stream states (`"bt709"`), or nil. Programs assume different ones if it is
      missing, so a decoder should then use BT.601, as FFmpeg does
    * `packets`: one record of 13 bytes for each packet, in the order in which a decoder needs them: the time of the
      image as a signed 64-bit number (ns since 1970, or `hidden/0` if the packet is only decoded and never shown), the
      size of the packet in bytes (32 bits), and 1 if a decoder can start here, else 0 (8 bits)
  """
  alias Situ.{Error, Recording}
  alias Situ.Store.{Query, StreamInfo, VideoCoder}

  @enforce_keys [:codec, :description, :width, :height, :packets]
  defstruct [:codec, :description, :width, :height, :packets, :color, rotation: 0]

  @type t :: %__MODULE__{
          codec: String.t(),
          description: binary(),
          width: non_neg_integer(),
          height: non_neg_integer(),
          rotation: 0 | 90 | 180 | 270,
          color: String.t() | nil,
          packets: binary()
        }

  # The smallest time that can be stored cannot be the time of an image.
  @hidden -0x8000000000000000

  # A request for more bytes is refused.
  @most_bytes 32 * 1_048_576

  @doc "Returns the time of a packet whose image is never shown."
  @spec hidden() :: integer()
  def hidden, do: @hidden

  @doc """
  Describes the compressed images of a stream. Returns `:none` if the stream does not consist of them, and an error if
  they can be decoded only by the recording itself.
  """
  @spec fetch(Recording.t(), StreamInfo.t()) :: {:ok, t()} | :none | {:error, Error.t()}
  def fetch(%Recording{module: module, state: state} = recording, info) do
    if Recording.implements?(recording, :coded_video, 2),
      do: module.coded_video(state, info),
      else: VideoCoder.describe_packets(recording, info)
  end

  @doc "Returns the bytes of `count` packets, beginning with packet number `first`, as a list."
  @spec read_packets(Recording.t(), StreamInfo.t(), non_neg_integer(), non_neg_integer()) ::
          {:ok, [binary()]} | {:error, Error.t()}
  def read_packets(%Recording{module: module, state: state} = recording, info, first, count) do
    if Recording.implements?(recording, :coded_packets, 4),
      do: module.coded_packets(state, info, first, count),
      else: read_stored(recording, info, first, count)
  end

  # The first messages of a segmented recording may have been deleted, so its ordinals can begin above 0.
  defp read_stored(recording, info, first, count) do
    with {:ok, [_ | _] = start, next} <- read_some(recording, info, 0, 1) do
      base = next - length(start)
      collect_stored(recording, info, {base + first, count}, {[], @most_bytes})
    else
      {:ok, [], _} -> {:error, no_packets_error(info)}
      error -> error
    end
  end

  defp collect_stored(_recording, _info, {_ordinal, 0}, {read, _bytes}),
    do: {:ok, read |> Enum.reverse() |> Enum.concat()}

  defp collect_stored(recording, info, {ordinal, count}, {read, bytes}) do
    with {:ok, [_ | _] = messages, next} <- read_some(recording, info, ordinal, count),
         {:ok, packets, size} <- packet_bytes(messages),
         true <- size <= bytes or read == [] do
      rest = {next, count - length(messages)}
      collect_stored(recording, info, rest, {[packets | read], bytes - size})
    else
      {:error, error} -> {:error, error}
      false -> {:error, too_many_error()}
      _ -> {:error, no_packets_error(info)}
    end
  end

  defp read_some(recording, info, ordinal, count),
    do: Query.read_batch(recording, info, ordinal, :unbounded, count, exact: true, packets: true)

  defp packet_bytes(messages) do
    if Enum.all?(messages, &is_struct(&1.data, Situ.VideoPacket)) do
      packets = Enum.map(messages, & &1.data.data)
      {:ok, packets, packets |> Enum.map(&byte_size/1) |> Enum.sum()}
    else
      :none
    end
  end

  defp no_packets_error(info),
    do: Error.new(:bad_option, "#{inspect(info.name)} does not have these packets")

  defp too_many_error do
    Error.new(:bad_option, "the requested packets have more than 32 MB",
      fix: "request fewer packets"
    )
  end

  @doc """
  Returns the number of packets.

      iex> alias Situ.Recording.CodedVideo
      iex> packets = <<0::signed-64, 900::32, 1, CodedVideo.hidden()::signed-64, 40::32, 0>>
      iex> video = %CodedVideo{codec: "vp8", description: "", width: 2, height: 2, packets: packets}
      iex> {CodedVideo.packet_count(video), CodedVideo.list_packets(video)}
      {2, [{0, 900, true}, {:hidden, 40, false}]}
  """
  @spec packet_count(t()) :: non_neg_integer()
  def packet_count(%__MODULE__{packets: packets}), do: div(byte_size(packets), 13)

  @doc "Returns the packets as `{time | :hidden, size, key?}`."
  @spec list_packets(t()) :: [{Situ.Time.t() | :hidden, non_neg_integer(), boolean()}]
  def list_packets(%__MODULE__{packets: packets}) do
    for <<time::signed-64, size::32, key::8 <- packets>>,
      do: {if(time == @hidden, do: :hidden, else: time), size, key == 1}
  end

  @doc "Adds `offset` ns to the times of all images."
  @spec shift_times(t(), Situ.Time.duration()) :: t()
  def shift_times(video, 0), do: video

  def shift_times(%__MODULE__{packets: packets} = video, offset) do
    packets =
      for <<time::signed-64, rest::40 <- packets>>, into: <<>> do
        time = if time == @hidden, do: time, else: time + offset
        <<time::signed-64, rest::40>>
      end

    %{video | packets: packets}
  end
end
