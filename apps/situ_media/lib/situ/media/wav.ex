defmodule Situ.Media.Wav do
  @moduledoc """
  Reads and writes complete WAV files.

  Supports PCM of 8, 16, 24 and 32 bits, float of 32 and 64 bits, `WAVE_FORMAT_EXTENSIBLE`, RF64 (files over 4 GB),
  streamed files (without a length in the header), and files truncated at any byte. Memory is never allocated
  according to sizes in a header: chunks are skipped by seeking, and audio is read in buffers of a size that the
  caller sets.

      iex> path = Path.join(System.tmp_dir!(), "situ_wav_doctest.wav")
      iex> buffer = Situ.AudioBuffer.from_samples([0, 1, -1], Situ.AudioFormat.pcm(8_000))
      iex> :ok = Situ.Media.Wav.write(path, buffer)
      iex> Situ.Media.Wav.read(path) == {:ok, buffer}
      true
      iex> File.rm!(path)
      :ok

  For pipelines, use `Situ.Media.WavFile` (source) and `Situ.Media.WavWriter` (sink). To open a file as a recording,
  use `Situ.Store.open("talk.wav")`: its stream `Audio` has buffers of 20 ms, the file begins at the time stored in it
  (or at 0, or at the time given by `reader_opts: [start: time]`), and `Situ.Store.info/1` lists missing data under
  `damage`. For compressed WAV (A-law, ADPCM, ...), use `Situ.Media.VideoFile`, which supports every codec of FFmpeg.
  """
  alias Situ.{AudioBuffer, Error}
  alias Situ.Media.Wav.{Reader, Writer}

  @doc """
  Reads a complete file as one buffer. A truncated file is an error here; `Situ.Media.WavFile` and `Situ.Store.open/2`
  read its available part.
  """
  @spec read(Path.t()) :: {:ok, AudioBuffer.t()} | {:error, Error.t()}
  def read(path) do
    with {:ok, reader} <- Reader.open(path, buffer: 1_000_000_000) do
      try do
        collect_buffers(Reader.next_buffer(reader), [], reader.format)
      after
        Reader.close_file(reader)
      end
    end
  end

  defp collect_buffers({:ok, _time, buffer, reader}, data, format),
    do: collect_buffers(Reader.next_buffer(reader), [data | [buffer.data]], format)

  defp collect_buffers(:eof, data, format),
    do: {:ok, %AudioBuffer{format: format, data: IO.iodata_to_binary(data)}}

  defp collect_buffers({:error, error}, _data, _format), do: {:error, error}

  @doc """
  Writes `buffer` to a WAV file. The option `start_time:` (ns) is stored in the file and read by `Situ.Media.WavFile`.
  """
  @spec write(Path.t(), AudioBuffer.t(), keyword()) :: :ok | {:error, Error.t()}
  def write(path, %AudioBuffer{} = buffer, opts \\ []) do
    with {:ok, buffer} <- AudioBuffer.validate(buffer),
         {:ok, writer} <- Writer.open(path, buffer.format, opts),
         {:ok, writer} <- Writer.append_buffer(writer, buffer) do
      Writer.finish_file(writer)
    end
  end
end
