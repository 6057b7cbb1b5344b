defmodule Situ.Media.Recording.OpenFile do
  @moduledoc false
  # A media file as it was when it was opened: its packets' times, and where its sound begins and ends.

  alias Situ.{AudioBuffer, AudioFormat, Error}
  alias Situ.Media.{Decoder, FileInfo, FileTime}
  alias Situ.Media.Recording.Index

  @enforce_keys [:path, :version, :info, :index, :start]
  defstruct [:path, :version, :info, :index, :start, :sound, :print]

  # `print` is what tells two contents from each other that were written within one second.
  @typedoc "`first` is the media time of the sound's first frame, in frames; `step` the frames of a piece."
  @type sound :: %{
          format: AudioFormat.t(),
          first: integer(),
          frames: non_neg_integer(),
          step: pos_integer()
        }
  @type t :: %__MODULE__{
          path: Path.t(),
          version: term(),
          info: FileInfo.t(),
          index: Index.t(),
          start: Situ.Time.t(),
          sound: sound() | nil,
          print: non_neg_integer()
        }

  @schema [
    start: [
      type: {:or, [{:in, [:file]}, :integer]},
      default: :file,
      doc: "Originating time of the file's beginning, ns."
    ]
  ]
  @piece 20_000_000
  # Pieces that are decoded together: half a minute.
  @stretch 1_500

  @doc "How long a piece of sound is, ns."
  @spec piece() :: Situ.Time.duration()
  def piece, do: @piece

  @doc "How many pieces of sound are decoded together."
  @spec stretch() :: pos_integer()
  def stretch, do: @stretch

  @doc "Opens the file, lists its packets and decodes the first piece of its sound."
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def open(path, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, info} <- FileInfo.read(path),
         {:ok, version} <- version(path),
         {:ok, index} <- Index.read(path, info),
         {:ok, sound} <- sound(path, info, index) do
      start = FileTime.offset(opts[:start], info.recorded_at, 0, %{start_time: 0})
      info = if Index.count(index) == 0, do: %{info | video: nil}, else: info

      recording = %__MODULE__{
        path: path,
        version: version,
        info: info,
        index: index,
        start: start
      }

      {:ok, %{recording | sound: sound, print: :erlang.phash2({info, index, sound})}}
    end
  end

  defp version(path) do
    case File.stat(path, time: :posix) do
      {:ok, stat} -> {:ok, {stat.size, stat.mtime}}
      {:error, reason} -> {:error, Error.new(:no_file, "cannot read #{path}: #{reason}")}
    end
  end

  @doc "Whether the file is still the one that was opened."
  @spec unchanged(t()) :: :ok | {:error, Error.t()}
  def unchanged(%{path: path, version: version}) do
    case version(path) do
      {:ok, ^version} -> :ok
      {:ok, _} -> {:error, Error.new(:changed, "#{path} has changed since it was opened")}
      error -> error
    end
  end

  # Where the sound begins shows in its first piece: codecs have a lead-in that containers tell in ways of their own.
  defp sound(_path, %{audio: nil}, _index), do: {:ok, nil}

  defp sound(path, info, index) do
    with {:ok, decoder} <- Decoder.open(path, info, video: false, audio_buffer: @piece) do
      item = Decoder.next(decoder)
      Decoder.close(decoder)

      case item do
        {:audio, time, %{format: format} = buffer, _} ->
          first = AudioFormat.ns_to_frames(format, time) - AudioBuffer.frames(buffer)
          frames = AudioFormat.ns_to_frames(format, index.sound_end) - first
          step = max(AudioFormat.ns_to_frames(format, @piece), 1)
          {:ok, %{format: format, first: first, frames: max(frames, 0), step: step}}

        # A film with silent or broken sound is still a film.
        _ when info.video != nil ->
          {:ok, nil}

        {:error, error, _} ->
          {:error, error}

        {:eof, _} ->
          {:ok, nil}
      end
    end
  end
end
