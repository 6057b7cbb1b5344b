defmodule Situ.Media.Recording.Index do
  @moduledoc false
  # An index of the images and the audio of a media file, built by reading its packets without
  # decoding them.
  #
  # `pictures` and `keys` hold packed numbers: the times of all images (media time, ns,
  # increasing), and the ordinals of the images at which a decoder can start. Two hours at 24
  # images per second take 1.4 MB, shared by all processes that hold them.
  alias Situ.Error
  alias Situ.Media.{FFmpeg, FileInfo, Nut}
  alias Situ.Media.Recording.{Packets, PacketPlaces}

  # `places` holds the packets as FFmpeg decodes them (`Situ.Media.Recording.PacketPlaces`), `nil` if only FFmpeg can
  # read them.
  defstruct pictures: <<>>,
            keys: <<>>,
            picture_bytes: 0,
            sound_end: nil,
            sound_bytes: 0,
            places: nil

  @type t :: %__MODULE__{
          pictures: binary(),
          keys: binary(),
          picture_bytes: non_neg_integer(),
          sound_end: Situ.Time.t() | nil,
          sound_bytes: non_neg_integer(),
          places: binary() | nil
        }

  @seconds 120
  # Ten years, which is longer than any real media file.
  @longest 315_360_000_000_000_000
  @packets "format=start_time:stream=index,time_base:packet=stream_index,pts,dts,duration,size,pos,flags,data_hash"
  @frames "frame=best_effort_timestamp,key_frame"

  @doc "Builds the index from the packets of the file. Gives up after two minutes."
  @spec read_packets(Path.t(), FileInfo.t()) :: {:ok, t()} | {:error, Error.t()}
  def read_packets(path, %FileInfo{} = info) do
    new = Packets.new(info.video && info.video.index, info.audio && info.audio.index)

    with {:ok, packets} <-
           run_ffprobe(path, info, ~w(-show_data_hash adler32 -show_entries #{@packets}), new) do
      {:ok,
       build_index(info, if(packets.vague?, do: read_frames(path, info, packets), else: packets))}
    end
  end

  # Some old containers (AVI, MPEG-PS) omit times, and only a decoder knows the order of the images. If decoding takes
  # too long, the order of the packets is used.
  defp read_frames(path, info, packets) do
    args = ["-select_streams", "#{info.video.index}", "-show_entries", @frames]

    case run_ffprobe(path, info, args, %{packets | rest: ""}) do
      {:ok, %{frames: [_ | _]} = packets} -> %{packets | pictures: packets.frames}
      _ -> packets
    end
  end

  defp run_ffprobe(path, info, entries, into) do
    args =
      ~w(-k 1 #{@seconds} ffprobe -hide_banner -loglevel quiet -of csv) ++
        entries ++ FFmpeg.local_file(path)

    case System.cmd("timeout", args, env: [], into: into) do
      # The packets that ffprobe listed are usable, even if it failed at the end.
      {packets, status} when status not in [124, 137] -> {:ok, packets}
      {_, _} -> {:error, unreadable_error(info)}
    end
  end

  defp build_index(info, packets) do
    video = packets.bases[packets.video]
    audio = packets.bases[packets.audio]
    zero = if info.exact?, do: 0, else: packets.zero

    pictures =
      for {ticks, key?} <- if(video, do: packets.pictures, else: []),
          time = ticks_to_ns(ticks, video, zero),
          time >= 0 and time < @longest,
          do: {time, key?}

    pictures = pictures |> Enum.sort() |> Enum.dedup_by(&elem(&1, 0))
    keys = for {{_, true}, ordinal} <- Enum.with_index(pictures), into: <<>>, do: <<ordinal::32>>

    %__MODULE__{
      pictures: for({time, _} <- pictures, into: <<>>, do: <<time::64>>),
      keys: keys,
      picture_bytes: packets.picture_bytes,
      sound_end: sound_end(info, packets.sound_end, audio, zero),
      sound_bytes: packets.sound_bytes,
      places: pack_places(packets, video, zero, length(pictures))
    }
  end

  # If two images have the same time, their packets cannot be distinguished.
  defp pack_places(%{placed?: true, places: [_ | _] = places}, base, zero, count) do
    packed = PacketPlaces.pack(places, &image_time_or_nil(&1, base, zero))
    if PacketPlaces.shown_count(packed) == count, do: packed
  end

  defp pack_places(_packets, _base, _zero, _count), do: nil

  defp image_time_or_nil(ticks, base, zero) do
    time = ticks_to_ns(ticks, base, zero)
    if time >= 0 and time < @longest, do: time
  end

  # MP4 and related formats state the exact audio length; in other formats the packets are used.
  defp sound_end(%{audio: nil}, _ticks, _base, _zero), do: nil

  defp sound_end(%{format: "mov" <> _, audio: %{duration: stated}}, _ticks, _base, _zero)
       when is_integer(stated),
       do: stated

  defp sound_end(_info, ticks, base, zero) when ticks != nil and base != nil,
    do: ticks |> ticks_to_ns(base, zero) |> max(0) |> min(@longest)

  defp sound_end(_info, _ticks, _base, _zero), do: 0

  # Shifts times as ffmpeg's `-start_at_zero` does: by the file's start in microseconds, rounded to the stream's
  # ticks.
  defp ticks_to_ns(ticks, {num, den} = base, zero) do
    shift = Integer.floor_div(2 * zero * den + num * 1_000_000, 2 * num * 1_000_000)
    Nut.to_ns(ticks - shift, base)
  end

  defp unreadable_error(info) do
    Error.new(:unreadable_media, "cannot list the packets of #{info.name}",
      why: "FFmpeg found no packets in it, or took longer than #{@seconds} s",
      fix: "check that the file is complete: ffprobe #{info.name}"
    )
  end

  @doc """
  Returns the number of images.

      iex> index = %Situ.Media.Recording.Index{
      ...>   pictures: <<0::64, 40::64, 80::64, 120::64>>, keys: <<0::32, 2::32>>}
      iex> alias Situ.Media.Recording.Index
      iex> {Index.image_count(index), Index.image_time(index, 2), Index.seek_image(index, 41)}
      {4, 80, 2}
      iex> {Index.nearest_image(index, 55), Index.key_image(index, 3)}
      {1, 2}
  """
  @spec image_count(t()) :: non_neg_integer()
  def image_count(index), do: div(byte_size(index.pictures), 8)

  @doc "Returns the media time of an image."
  @spec image_time(t(), non_neg_integer()) :: Situ.Time.t()
  def image_time(index, ordinal) do
    <<time::64>> = binary_part(index.pictures, ordinal * 8, 8)
    time
  end

  @doc "Returns the ordinal of the first image at or after a media time, or the count if there is none."
  @spec seek_image(t(), integer()) :: non_neg_integer()
  def seek_image(index, time),
    do: binary_search(&(image_time(index, &1) >= time), 0, image_count(index))

  @doc "Returns the ordinal of the image whose time is nearest."
  @spec nearest_image(t(), integer()) :: non_neg_integer()
  def nearest_image(index, time) do
    case seek_image(index, time) do
      0 ->
        0

      after_it ->
        before = after_it - 1

        if after_it < image_count(index) and
             image_time(index, after_it) - time <= time - image_time(index, before),
           do: after_it,
           else: before
    end
  end

  @doc "Returns the ordinal of the last key frame at or before `ordinal`, or 0 if none is marked."
  @spec key_image(t(), non_neg_integer()) :: non_neg_integer()
  def key_image(index, ordinal) do
    later = binary_search(&(key_at(index, &1) > ordinal), 0, div(byte_size(index.keys), 4))
    if later == 0, do: 0, else: key_at(index, later - 1)
  end

  defp key_at(index, i) do
    <<ordinal::32>> = binary_part(index.keys, i * 4, 4)
    ordinal
  end

  # Returns the first i in low..high-1 for which the monotonic predicate `holds?` is true, or `high` if there is none.
  defp binary_search(_holds?, low, low), do: low

  defp binary_search(holds?, low, high) do
    middle = div(low + high, 2)

    if holds?.(middle),
      do: binary_search(holds?, low, middle),
      else: binary_search(holds?, middle + 1, high)
  end
end
