defmodule Situ.Media.Recording do
  @moduledoc false
  # Opens media files as recordings with the streams `Video` and `Audio`. `Situ.Media` documents them for users.
  #
  # Opening decodes only the first audio buffer. A process for each file decodes images on request and ends when it is
  # idle. It continues from the last image or starts at the previous key frame, and caches up to 64 MB of images for
  # stepping back. If the last audio buffer is shorter than the file states, it is padded with silence.
  # See docs/adr/0053-media-files-open-as-recordings.md.
  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format
  import Bitwise

  alias Situ.{AudioBuffer, AudioFormat, Message}
  alias Situ.Media.Recording.{Index, OpenFile, CodedImages, Images, Audio, Waveform}
  alias Situ.Store.StreamInfo

  @impl true
  defdelegate open(path, opts), to: OpenFile

  @videos ~w(.mp4 .m4v .mov .mkv .webm .avi .mpg .mpeg .m2ts .mts .flv .wmv .3gp .ogv)
  @sounds ~w(.mp3 .m4a .aac .flac .ogg .oga .opus .mka)

  @impl true
  def extensions, do: @videos ++ @sounds

  @impl true
  def kinds,
    do: [
      %Situ.Recording.FileKind{
        name: :video,
        title: "Video",
        extensions: @videos,
        signatures: [{4, "ftyp"}, {0, <<0x1A, 0x45, 0xDF, 0xA3>>}],
        open: __MODULE__,
        # `Situ.Media.copy_video/4` writes these.
        export: ~w(.mp4 .mov .mkv .webm)
      },
      %Situ.Recording.FileKind{
        name: :audio,
        title: "Compressed audio",
        extensions: @sounds,
        signatures: [{0, "fLaC"}, {0, "OggS"}, {0, "ID3"}],
        open: __MODULE__
      }
    ]

  @impl true
  def info(recording) do
    name = Path.basename(recording.path, Path.extname(recording.path))
    %{name: name, created: recording.info.recorded_at, closed?: true, live?: false, damage: []}
  end

  @impl true
  def streams(recording), do: video_streams(recording) ++ audio_streams(recording)

  defp video_streams(%{info: %{video: nil}}), do: []

  defp video_streams(%{index: index, info: %{video: video}} = recording) do
    count = Index.image_count(index)
    size = count * video.width * video.height * 3

    [
      build_stream_info(
        recording,
        %{id: 1, name: "Video", type: Situ.Image, count: count},
        size,
        index.picture_bytes
      )
    ]
  end

  defp audio_streams(%{sound: nil}), do: []

  defp audio_streams(%{sound: sound, index: index} = recording) do
    count = div(sound.frames + sound.step - 1, sound.step)
    size = sound.frames * AudioFormat.bytes_per_frame(sound.format)

    [
      build_stream_info(
        recording,
        %{id: 2, name: "Audio", type: AudioBuffer, count: count},
        size,
        index.sound_bytes
      )
    ]
  end

  defp build_stream_info(recording, %{count: count} = fields, size, stored) do
    info = struct!(StreamInfo, fields)
    first = if count > 0, do: message_time(recording, info, 0)
    last = if count > 0, do: message_time(recording, info, count - 1)

    %{
      info
      | store_name: info(recording).name,
        store_path: recording.path,
        type_name: inspect(info.type),
        size: size,
        stored: stored,
        opened: recording.start,
        closed: last || recording.start,
        first: first,
        last: last,
        first_creation: first,
        last_creation: last
    }
  end

  defp message_time(recording, %{name: "Video"}, ordinal),
    do: recording.start + Index.image_time(recording.index, ordinal)

  defp message_time(%{sound: sound} = recording, _info, ordinal) do
    finish = sound.first + min((ordinal + 1) * sound.step, sound.frames)
    recording.start + AudioFormat.frames_to_ns(sound.format, finish)
  end

  @impl true
  def seek(recording, %{name: "Video"}, time),
    do: {:ok, Index.seek_image(recording.index, time - recording.start)}

  def seek(%{sound: sound} = recording, info, time) do
    frame = AudioFormat.ns_to_frames(sound.format, time - recording.start) - sound.first
    guess = div(max(frame, 0), sound.step)
    # Rounding can make the guess off by one in either direction.
    near =
      Enum.find(
        max(guess - 2, 0)..(guess + 2),
        &(&1 >= info.count or message_time(recording, info, &1) >= time)
      )

    {:ok, min(near || info.count, info.count)}
  end

  @impl true
  def read(recording, info, ordinal, to, limit, opts) do
    last = last_before(recording, info, to)

    cond do
      ordinal > last ->
        {:ok, [], ordinal}

      opts[:envelopes] ->
        read_envelopes(recording, info, ordinal..min(last, ordinal + limit - 1))

      info.name == "Video" ->
        read_images(recording, info, ordinal, min(limit, last - ordinal + 1))

      true ->
        read_audio(recording, info, ordinal, min(limit, last - ordinal + 1))
    end
  end

  # Returns the ordinal of the last message at or before `to`.
  defp last_before(_recording, info, :unbounded), do: info.count - 1

  defp last_before(recording, info, to) do
    {:ok, next} = seek(recording, info, to + 1)
    next - 1
  end

  defp read_envelopes(recording, info, ordinals) do
    {:ok, Enum.map(ordinals, &build_message(recording, info, &1, nil)), ordinals.last + 1}
  end

  defp read_images(recording, info, ordinal, limit) do
    case Images.fetch_range(recording, ordinal, limit) do
      {:ok, []} ->
        {:ok, [], ordinal}

      {:ok, pictures} ->
        messages = for {at, image} <- pictures, do: build_message(recording, info, at, image)
        {:ok, messages, elem(List.last(pictures), 0) + 1}

      {:error, error} ->
        {:error, error}
    end
  end

  defp read_audio(%{sound: sound} = recording, info, ordinal, limit) do
    {number, skip} =
      {div(ordinal, OpenFile.chunks_per_batch()), rem(ordinal, OpenFile.chunks_per_batch())}

    with {:ok, data, error} <- Audio.read_batch(recording, number) do
      size = sound.step * AudioFormat.bytes_per_frame(sound.format)
      there = div(byte_size(data) + size - 1, size)

      messages =
        for i <- skip..(min(skip + limit, there) - 1)//1 do
          at = ordinal + i - skip

          piece = %AudioBuffer{
            format: sound.format,
            data: chunk_bytes(recording, at, data, i * size)
          }

          build_message(recording, info, at, piece)
        end

      # Returns the messages read so far first, and the error with the next read.
      if messages == [] and error,
        do: {:error, error},
        else: {:ok, messages, ordinal + length(messages)}
    end
  end

  defp chunk_bytes(%{sound: sound}, ordinal, data, from) do
    frame = AudioFormat.bytes_per_frame(sound.format)
    wanted = min(sound.step, sound.frames - ordinal * sound.step) * frame
    there = min(wanted, byte_size(data) - from)
    part = binary_part(data, from, there)
    if there == wanted, do: part, else: part <> :binary.copy(<<0>>, wanted - there)
  end

  defp build_message(recording, info, ordinal, data) do
    time = message_time(recording, info, ordinal)

    %Message{
      data: data,
      originating_time: time,
      creation_time: time,
      sequence_id: ordinal + 1,
      source_id: info.id
    }
  end

  @impl true
  def summary(_recording, %{name: "Video"}, from, to, pixels),
    do: {:ok, 1 <<< bin_level(from, to, pixels), []}

  def summary(recording, info, from, to, pixels) do
    level = bin_level(from, to, pixels)

    if level >= Waveform.finest_level() do
      with {:ok, waveform} <- Audio.fetch_waveform(recording),
           do: {:ok, 1 <<< level, Waveform.list_bins(waveform, from, to, level)}
    else
      with {:ok, first} <- seek(recording, info, from),
           {:ok, points} <-
             collect_points(recording, info, first, to + OpenFile.chunk_duration(), []) do
        {:ok, 1 <<< level, fold_points(points, from, to, level)}
      end
    end
  end

  @impl true
  def coded_video(recording, %{name: "Video"}), do: CodedImages.describe(recording)
  def coded_video(_recording, _info), do: :none

  @impl true
  def coded_packets(recording, _info, first, count),
    do: CodedImages.read_packets(recording, first, count)

  # Returns the exponent of the largest power of two that is not wider than a pixel.
  defp bin_level(from, to, pixels) do
    width = max(div(to - from, pixels), 1)
    length(Integer.digits(width, 2)) - 1
  end

  # Decodes the samples, which is fast enough for a span this short.
  defp collect_points(recording, info, ordinal, to, done) do
    case read(recording, info, ordinal, to, OpenFile.chunks_per_batch(), []) do
      {:ok, [], _} ->
        {:ok, done |> Enum.reverse() |> Enum.concat()}

      {:ok, messages, next} ->
        points = Enum.flat_map(messages, &Situ.AudioOps.points!(&1.data, &1.originating_time))
        collect_points(recording, info, next, to, [points | done])

      {:error, error} ->
        {:error, error}
    end
  end

  defp fold_points(points, from, to, level) do
    points
    |> Enum.filter(fn {time, _, _, _, _} -> time >= from and time <= to end)
    |> Enum.chunk_by(&(elem(&1, 0) >>> level))
    |> Enum.map(fn [{time, min, max, last, n} | rest] ->
      start = time >>> level <<< level

      Enum.reduce(rest, {start, min, max, last, n}, fn {_, low, high, last, n},
                                                       {t, min, max, _, count} ->
        {t, min(min, low), max(max, high), last, count + n}
      end)
    end)
  end
end
