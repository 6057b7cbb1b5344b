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

  In pipelines: `Situ.Media.WavFile` (source) and `Situ.Media.WavWriter` (sink). Compressed WAV (A-law, ADPCM, ...) is
  read by `Situ.Media.VideoFile`, which knows every codec FFmpeg does.
  """
  alias Situ.{AudioBuffer, AudioFormat, Error}
  alias Situ.Media.Wav.{Reader, Writer}

  @pcm 1
  @float 3
  @extensible 0xFFFE
  # The tail of the sub-format's GUID: xxxxxxxx-0000-0010-8000-00AA00389B71.
  @guid <<0x0000::little-16, 0x0010::little-16, 0x80, 0x00, 0x00, 0xAA, 0x00, 0x38, 0x9B, 0x71>>

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

  @doc """
  The body of a `fmt ` chunk for a format.

      iex> {:ok, format} = Situ.Media.Wav.parse_format(Situ.Media.Wav.encode_format(Situ.AudioFormat.pcm(44_100, 2, :f32)))
      iex> format
      #Situ.AudioFormat<44100 Hz, 2 ch, :f32>
  """
  @spec encode_format(AudioFormat.t()) :: binary()
  def encode_format(%AudioFormat{} = format) do
    tag = if format.sample in [:f32, :f64], do: @float, else: @pcm
    bits = 8 * AudioFormat.bytes_per_sample(format)

    plain =
      <<format.rate::little-32, AudioFormat.bytes_per_second(format)::little-32,
        AudioFormat.bytes_per_frame(format)::little-16, bits::little-16>>

    # More than two channels or 16 bits, and float, are written the extensible way, as the format's authors ask.
    if tag == @pcm and bits <= 16 and format.channels <= 2 do
      <<@pcm::little-16, format.channels::little-16, plain::binary>>
    else
      <<@extensible::little-16, format.channels::little-16, plain::binary, 22::little-16,
        bits::little-16, 0::little-32, tag::little-32, @guid::binary>>
    end
  end

  @doc "The format a `fmt ` chunk means."
  @spec parse_format(binary()) :: {:ok, AudioFormat.t()} | {:error, Error.t()}
  def parse_format(
        <<@extensible::little-16, plain::binary-size(14), _size::little-16, _valid::little-16,
          _mask::little-32, tag::little-16, _guid::binary-size(14), _::binary>>
      ),
      do: parse_plain(tag, plain)

  def parse_format(<<tag::little-16, plain::binary-size(14), _::binary>>),
    do: parse_plain(tag, plain)

  def parse_format(bytes), do: bad("its fmt chunk has only #{byte_size(bytes)} bytes")

  defp parse_plain(
         tag,
         <<channels::little-16, rate::little-32, _::32, block::little-16, bits::little-16>>
       ) do
    with {:ok, sample} <- sample(tag, bits),
         {:ok, format} <-
           AudioFormat.validate(%AudioFormat{rate: rate, channels: channels, sample: sample}) do
      if block == AudioFormat.bytes_per_frame(format),
        do: {:ok, format},
        else: bad("a frame of #{channels} channels of #{bits} bits cannot have #{block} bytes")
    else
      {:error, %{what: what}} -> bad(what)
    end
  end

  defp sample(@pcm, 8), do: {:ok, :u8}
  defp sample(@pcm, 16), do: {:ok, :s16}
  defp sample(@pcm, 24), do: {:ok, :s24}
  defp sample(@pcm, 32), do: {:ok, :s32}
  defp sample(@float, 32), do: {:ok, :f32}
  defp sample(@float, 64), do: {:ok, :f64}

  defp sample(tag, bits) when tag in [@pcm, @float],
    do: {:error, Error.new(:bad_wav, "samples of #{bits} bits are unknown")}

  defp sample(tag, _bits) do
    {:error,
     Error.new(:bad_wav, "its sound is compressed (format tag #{tag}), read it with VideoFile")}
  end

  defp bad(why), do: {:error, Error.new(:bad_wav, "not a usable WAV file", why: why)}
end
