defmodule Situ.Media.Wav.Recording do
  @moduledoc """
  Opens WAV files as recordings. `Situ.Store.open("talk.wav")` has one stream, `Audio`, with buffers of 20 ms.

  The originating time of a buffer is the time of its end. The file begins at the time stored in it (ICRD), or at 0. The
  option `start:` (ns) overrides it: `Situ.Store.open("talk.wav", reader_opts: [start: time])`. A truncated file is read
  up to its end, and `Situ.Store.info/1` lists the missing data under `damage`. `Situ.Media.Wav` lists the supported
  kinds of WAV.
  """
  @behaviour Situ.Store.Reader

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
  def open(path, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, reader} <- Reader.open(path),
         :ok <- Reader.close(reader),
         {:ok, stat} <- stat(path) do
      step = max(AudioFormat.ns_to_frames(reader.format, @piece), 1)
      start = opts[:start] || reader.recorded_at || 0
      {:ok, %__MODULE__{path: path, reader: reader, stat: stat, step: step, start: start}}
    end
  end

  defp stat(path) do
    case File.stat(path, time: :posix) do
      {:ok, stat} -> {:ok, {stat.size, stat.mtime}}
      {:error, _} -> changed(path)
    end
  end

  defp changed(path) do
    {:error,
     Error.new(:changed, "#{path} has changed since it was opened", fix: "open the file again")}
  end

  @impl true
  def info(%{reader: reader} = recording) do
    damage = if Reader.missing(reader) > 0, do: [damage(reader)], else: []
    name = name(recording)
    %{name: name, created: reader.recorded_at, closed?: true, live?: false, damage: damage}
  end

  defp damage(reader) do
    {Reader.frames(reader),
     "the header states #{Reader.missing(reader)} bytes more than the file contains"}
  end

  defp name(recording), do: Path.basename(recording.path, Path.extname(recording.path))

  @impl true
  def streams(recording) do
    count = count(recording)
    size = Reader.frames(recording.reader) * AudioFormat.bytes_per_frame(recording.reader.format)
    first = if count > 0, do: time(recording, 0)
    last = if count > 0, do: time(recording, count - 1)

    [
      %StreamInfo{
        id: 1,
        name: "Audio",
        store_name: name(recording),
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

  defp count(%{step: step} = recording),
    do: div(Reader.frames(recording.reader) + step - 1, step)

  defp time(%{reader: reader} = recording, ordinal),
    do: recording.start + AudioFormat.frames_to_ns(reader.format, finish(recording, ordinal))

  # Returns the frame after the last frame of a buffer.
  defp finish(recording, ordinal),
    do: min((ordinal + 1) * recording.step, Reader.frames(recording.reader))

  @impl true
  def seek(recording, _info, time) do
    frame = AudioFormat.ns_to_frames(recording.reader.format, max(time - recording.start, 0))
    guess = div(frame, recording.step)
    last = count(recording)
    # Rounding can make the guess off by one in either direction.
    near = max(guess - 2, 0)..(guess + 2)
    {:ok, Enum.find(near, last, &(&1 < last and time(recording, &1) >= time))}
  end

  @impl true
  def read(recording, info, ordinal, to, limit, _opts) do
    last = min(count(recording), ordinal + min(limit, @most)) - 1
    within? = &(to == :unbounded or time(recording, &1) <= to)

    case Enum.take_while(ordinal..last//1, within?) do
      [] -> {:ok, [], ordinal}
      ordinals -> load(recording, info, ordinals)
    end
  end

  defp load(recording, info, [first | _] = ordinals) do
    last = List.last(ordinals)
    from = first * recording.step

    with {:ok, sound} <- sound(recording, from, finish(recording, last) - from) do
      messages =
        for ordinal <- ordinals do
          at = ordinal * recording.step
          piece = AudioBuffer.slice(sound, at - from, finish(recording, ordinal) - at)
          message(recording, info, ordinal, piece)
        end

      {:ok, messages, last + 1}
    end
  end

  defp message(recording, info, ordinal, piece) do
    time = time(recording, ordinal)

    %Message{
      data: piece,
      originating_time: time,
      creation_time: time,
      sequence_id: ordinal + 1,
      source_id: info.id
    }
  end

  # Opens the file only during a read, so that any process can read a recording.
  defp sound(%{path: path, stat: stat} = recording, from, count) do
    with {:ok, ^stat} <- stat(path),
         {:ok, reader} <- Reader.reopen(recording.reader, path) do
      result = Reader.slice(reader, from, count)
      Reader.close(reader)
      result
    else
      {:error, error} -> {:error, error}
      {:ok, _other} -> changed(path)
    end
  end
end
