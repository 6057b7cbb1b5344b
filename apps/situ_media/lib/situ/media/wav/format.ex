defmodule Situ.Media.Wav.Format do
  @moduledoc false
  # Encodes and parses the `fmt ` chunk of a WAV file, which describes the samples.
  alias Situ.{AudioFormat, Error}

  @pcm 1
  @float 3
  @extensible 0xFFFE
  # The end of the sub-format's GUID: xxxxxxxx-0000-0010-8000-00AA00389B71.
  @guid <<0x0000::little-16, 0x0010::little-16, 0x80, 0x00, 0x00, 0xAA, 0x00, 0x38, 0x9B, 0x71>>

  @doc """
  Encodes the body of a `fmt ` chunk for a format.

      iex> chunk = Situ.Media.Wav.Format.encode_chunk(Situ.AudioFormat.pcm(44_100, 2, :f32))
      iex> {:ok, format} = Situ.Media.Wav.Format.parse_chunk(chunk)
      iex> format
      #Situ.AudioFormat<44100 Hz, 2 ch, :f32>
  """
  @spec encode_chunk(AudioFormat.t()) :: binary()
  def encode_chunk(%AudioFormat{} = format) do
    tag = if format.sample in [:f32, :f64], do: @float, else: @pcm
    bits = 8 * AudioFormat.bytes_per_sample(format)

    plain =
      <<format.rate::little-32, AudioFormat.bytes_per_second(format)::little-32,
        AudioFormat.bytes_per_frame(format)::little-16, bits::little-16>>

    # The specification requires the extensible form for more than two channels, more than 16 bits, and floats.
    if tag == @pcm and bits <= 16 and format.channels <= 2 do
      <<@pcm::little-16, format.channels::little-16, plain::binary>>
    else
      <<@extensible::little-16, format.channels::little-16, plain::binary, 22::little-16,
        bits::little-16, 0::little-32, tag::little-32, @guid::binary>>
    end
  end

  @doc "Parses the body of a `fmt ` chunk to a format."
  @spec parse_chunk(binary()) :: {:ok, AudioFormat.t()} | {:error, Error.t()}
  def parse_chunk(
        <<@extensible::little-16, plain::binary-size(14), _size::little-16, _valid::little-16,
          _mask::little-32, tag::little-16, _guid::binary-size(14), _::binary>>
      ),
      do: parse_plain(tag, plain)

  def parse_chunk(<<tag::little-16, plain::binary-size(14), _::binary>>),
    do: parse_plain(tag, plain)

  def parse_chunk(bytes), do: bad_wav("the fmt chunk has only #{byte_size(bytes)} bytes")

  defp parse_plain(
         tag,
         <<channels::little-16, rate::little-32, _::32, block::little-16, bits::little-16>>
       ) do
    with {:ok, sample} <- sample_type(tag, bits),
         {:ok, format} <-
           AudioFormat.validate(%AudioFormat{rate: rate, channels: channels, sample: sample}) do
      if block == AudioFormat.bytes_per_frame(format),
        do: {:ok, format},
        else:
          bad_wav("a frame of #{channels} channels with #{bits} bits cannot have #{block} bytes")
    else
      {:error, %{what: what}} -> bad_wav(what)
    end
  end

  defp sample_type(@pcm, 8), do: {:ok, :u8}
  defp sample_type(@pcm, 16), do: {:ok, :s16}
  defp sample_type(@pcm, 24), do: {:ok, :s24}
  defp sample_type(@pcm, 32), do: {:ok, :s32}
  defp sample_type(@float, 32), do: {:ok, :f32}
  defp sample_type(@float, 64), do: {:ok, :f64}

  defp sample_type(tag, bits) when tag in [@pcm, @float],
    do: {:error, Error.new(:bad_wav, "samples of #{bits} bits are not supported")}

  defp sample_type(tag, _bits) do
    {:error,
     Error.new(:bad_wav, "the audio is compressed (format tag #{tag}); read it with VideoFile")}
  end

  defp bad_wav(why),
    do: {:error, Error.new(:bad_wav, "invalid or unsupported WAV file", why: why)}
end
