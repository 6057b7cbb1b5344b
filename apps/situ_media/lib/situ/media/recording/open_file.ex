defmodule Situ.Media.Recording.OpenFile do
  @moduledoc false
  # The state of a media file when it was opened: the times of its packets, and the span of its audio.

  alias Situ.{AudioBuffer, AudioFormat, Error}
  alias Situ.Media.{Decoder, FileInfo, FileTime}
  alias Situ.Media.Recording.Index

  @enforce_keys [:path, :version, :info, :index, :start]
  defstruct [:path, :version, :info, :index, :start, :sound, :print]

  # `print` is a fingerprint that distinguishes two versions of a file written within the same second.
  @typedoc "`first` is the media time of the first audio frame, in frames; `step` is the number of frames in a buffer."
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
      doc: "Originating time of the file's start, ns."
    ]
  ]
  @piece 20_000_000
  # Number of audio buffers that are decoded together (30 s).
  @stretch 1_500

  @doc "Returns the length of an audio buffer, ns."
  @spec chunk_duration() :: Situ.Time.duration()
  def chunk_duration, do: @piece

  @doc "Returns the number of audio buffers that are decoded together."
  @spec chunks_per_batch() :: pos_integer()
  def chunks_per_batch, do: @stretch

  @doc "Opens the file, lists its packets and decodes the first audio buffer."
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def open(path, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, info} <- FileInfo.read(path),
         {:ok, version} <- file_version(path),
         {:ok, index} <- Index.read_packets(path, info),
         {:ok, sound} <- locate_audio(path, info, index) do
      start = FileTime.time_offset(opts[:start], info.recorded_at, 0, %{start_time: 0})
      info = if Index.image_count(index) == 0, do: %{info | video: nil}, else: info

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

  defp file_version(path) do
    case File.stat(path, time: :posix) do
      {:ok, stat} -> {:ok, {stat.size, stat.mtime}}
      {:error, reason} -> {:error, Error.new(:no_file, "cannot read #{path}: #{reason}")}
    end
  end

  @doc "Checks that the file has not changed since it was opened."
  @spec check_unchanged(t()) :: :ok | {:error, Error.t()}
  def check_unchanged(%{path: path, version: version}) do
    case file_version(path) do
      {:ok, ^version} -> :ok
      {:ok, _} -> {:error, Error.new(:changed, "#{path} has changed since it was opened")}
      error -> error
    end
  end

  # Finds the start of the audio in its first buffer, because containers describe the lead-in of codecs differently.
  defp locate_audio(_path, %{audio: nil}, _index), do: {:ok, nil}

  defp locate_audio(path, info, index) do
    with {:ok, decoder} <- Decoder.open(path, info, video: false, audio_buffer: @piece) do
      item = Decoder.next_item(decoder)
      Decoder.close(decoder)

      case item do
        {:audio, time, %{format: format} = buffer, _} ->
          first = AudioFormat.ns_to_frames(format, time) - AudioBuffer.frame_count(buffer)
          frames = AudioFormat.ns_to_frames(format, index.sound_end) - first
          step = max(AudioFormat.ns_to_frames(format, @piece), 1)
          {:ok, %{format: format, first: first, frames: max(frames, 0), step: step}}

        # A video with missing or damaged audio is still readable.
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
