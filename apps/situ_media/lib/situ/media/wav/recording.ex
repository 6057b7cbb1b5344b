defmodule Situ.Media.Wav.Recording do
  @moduledoc false
  # Opens WAV files as recordings. `Situ.Media.Wav` describes the stream. A truncated file is read up to its end.
  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format

  alias Situ.{AudioBuffer, AudioFormat, Error, Message}
  alias Situ.Media.Wav.Reader
  alias Situ.Store.StreamInfo

  @enforce_keys [:path, :reader, :stat, :step, :start]
  defstruct [:path, :reader, :stat, :step, :start]

  @schema [
    start: [
      type: {:optional, :integer},
      default: nil,
      doc: "Originating time of the file's start, ns; `nil`: as stored in the file, else 0."
    ]
  ]
  @piece 20_000_000
  # Maximum number of buffers per read (10 s).
  @most 500

  @impl true
  def extensions, do: [".wav"]

  @impl true
  def kinds,
    do: [
      %Situ.Recording.FileKind{
        name: :wav,
        title: "WAV audio",
        extensions: extensions(),
        signatures: [{8, "WAVEfmt "}],
        open: __MODULE__
      }
    ]

  @impl true
  def open(path, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, reader} <- Reader.open(path),
         :ok <- Reader.close_file(reader),
         {:ok, stat} <- file_version(path) do
      step = max(AudioFormat.ns_to_frames(reader.format, @piece), 1)
      start = opts[:start] || reader.recorded_at || 0
      {:ok, %__MODULE__{path: path, reader: reader, stat: stat, step: step, start: start}}
    end
  end

  defp file_version(path) do
    case File.stat(path, time: :posix) do
      {:ok, stat} -> {:ok, {stat.size, stat.mtime}}
      {:error, _} -> changed_error(path)
    end
  end

  defp changed_error(path) do
    {:error,
     Error.new(:changed, "#{path} has changed since it was opened", fix: "open the file again")}
  end

  @impl true
  def info(%{reader: reader} = recording) do
    damage = if Reader.missing_bytes(reader) > 0, do: [describe_damage(reader)], else: []
    name = recording_name(recording)
    %{name: name, created: reader.recorded_at, closed?: true, live?: false, damage: damage}
  end

  defp describe_damage(reader) do
    {Reader.frame_count(reader),
     "the header states #{Reader.missing_bytes(reader)} bytes more than the file contains"}
  end

  defp recording_name(recording), do: Path.basename(recording.path, Path.extname(recording.path))

  @impl true
  def streams(recording) do
    count = message_count(recording)

    size =
      Reader.frame_count(recording.reader) * AudioFormat.bytes_per_frame(recording.reader.format)

    first = if count > 0, do: message_time(recording, 0)
    last = if count > 0, do: message_time(recording, count - 1)

    [
      %StreamInfo{
        id: 1,
        name: "Audio",
        store_name: recording_name(recording),
        store_path: recording.path,
        type: AudioBuffer,
        type_name: inspect(AudioBuffer),
        count: count,
        size: size,
        stored: size,
        opened: recording.start,
        closed: last || recording.start,
        first: first,
        last: last,
        first_creation: first,
        last_creation: last
      }
    ]
  end

  defp message_count(%{step: step} = recording),
    do: div(Reader.frame_count(recording.reader) + step - 1, step)

  defp message_time(%{reader: reader} = recording, ordinal),
    do: recording.start + AudioFormat.frames_to_ns(reader.format, end_frame(recording, ordinal))

  # Returns the frame after the last frame of a buffer.
  defp end_frame(recording, ordinal),
    do: min((ordinal + 1) * recording.step, Reader.frame_count(recording.reader))

  @impl true
  def seek(recording, _info, time) do
    frame = AudioFormat.ns_to_frames(recording.reader.format, max(time - recording.start, 0))
    guess = div(frame, recording.step)
    last = message_count(recording)
    # Rounding can make the guess off by one in either direction.
    near = max(guess - 2, 0)..(guess + 2)
    {:ok, Enum.find(near, last, &(&1 < last and message_time(recording, &1) >= time))}
  end

  @impl true
  def read(recording, info, ordinal, to, limit, _opts) do
    last = min(message_count(recording), ordinal + min(limit, @most)) - 1
    within? = &(to == :unbounded or message_time(recording, &1) <= to)

    case Enum.take_while(ordinal..last//1, within?) do
      [] -> {:ok, [], ordinal}
      ordinals -> load_messages(recording, info, ordinals)
    end
  end

  defp load_messages(recording, info, [first | _] = ordinals) do
    last = List.last(ordinals)
    from = first * recording.step

    with {:ok, sound} <- read_audio(recording, from, end_frame(recording, last) - from) do
      messages =
        for ordinal <- ordinals do
          at = ordinal * recording.step
          piece = AudioBuffer.slice_frames(sound, at - from, end_frame(recording, ordinal) - at)
          build_message(recording, info, ordinal, piece)
        end

      {:ok, messages, last + 1}
    end
  end

  defp build_message(recording, info, ordinal, piece) do
    time = message_time(recording, ordinal)

    %Message{
      data: piece,
      originating_time: time,
      creation_time: time,
      sequence_id: ordinal + 1,
      source_id: info.id
    }
  end

  # Opens the file only during a read, so that any process can read a recording.
  defp read_audio(%{path: path, stat: stat} = recording, from, count) do
    with {:ok, ^stat} <- file_version(path),
         {:ok, reader} <- Reader.reopen_file(recording.reader, path) do
      result = Reader.read_slice(reader, from, count)
      Reader.close_file(reader)
      result
    else
      {:error, error} -> {:error, error}
      {:ok, _other} -> changed_error(path)
    end
  end
end
