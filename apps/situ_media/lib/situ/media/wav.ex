defmodule Situ.Media.Wav do
  @moduledoc """
  The WAV format: reading and writing whole files, and the header as data.

  Read: PCM of 8, 16, 24 and 32 bits, float of 32 and 64 bits, `WAVE_FORMAT_EXTENSIBLE`, RF64 (files over 4 GB), files
  that were streamed (no length in the header) and files cut off at any byte. Nothing is allocated by what a header
  claims: chunks are skipped by seeking, and sound is read in pieces of a size the caller chose.

      iex> path = Path.join(System.tmp_dir!(), "situ_wav_doctest.wav")
      iex> buffer = Situ.AudioBuffer.from_samples([0, 1, -1], Situ.AudioFormat.pcm(8_000))
      iex> :ok = Situ.Media.Wav.write(path, buffer)
      iex> Situ.Media.Wav.read(path) == {:ok, buffer}
      true
      iex> File.rm!(path)
      :ok

  In pipelines: `Situ.Media.WavFile` (source) and `Situ.Media.WavWriter` (sink). As a recording:
  `Situ.Store.open("talk.wav")`. Compressed WAV (A-law, ADPCM, ...) is read by `Situ.Media.VideoFile`, which knows
  every codec FFmpeg does.
  """
  alias Situ.{AudioBuffer, Error}
  alias Situ.Media.Wav.{Reader, Writer}

  @doc "The whole file as one buffer. A truncated file is an error here; `Situ.Media.Wav.Reader` gives what there is."
  @spec read(Path.t()) :: {:ok, AudioBuffer.t()} | {:error, Error.t()}
  def read(path) do
    with {:ok, reader} <- Reader.open(path, buffer: 1_000_000_000) do
      try do
        collect(Reader.next(reader), [], reader.format)
      after
        Reader.close(reader)
      end
    end
  end

  defp collect({:ok, _time, buffer, reader}, data, format),
    do: collect(Reader.next(reader), [data | [buffer.data]], format)

  defp collect(:eof, data, format),
    do: {:ok, %AudioBuffer{format: format, data: IO.iodata_to_binary(data)}}

  defp collect({:error, error}, _data, _format), do: {:error, error}

  @doc """
  Writes `buffer` as a WAV file. Option `start_time:` (ns) is kept in the file and found again by `Situ.Media.WavFile`.
  """
  @spec write(Path.t(), AudioBuffer.t(), keyword()) :: :ok | {:error, Error.t()}
  def write(path, %AudioBuffer{} = buffer, opts \\ []) do
    with {:ok, buffer} <- AudioBuffer.validate(buffer),
         {:ok, writer} <- Writer.open(path, buffer.format, opts),
         {:ok, writer} <- Writer.append(writer, buffer) do
      Writer.close(writer)
    end
  end
end
