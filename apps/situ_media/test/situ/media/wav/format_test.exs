defmodule Situ.Media.Wav.FormatTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.AudioFormat
  alias Situ.Media.Wav.Format
  doctest Situ.Media.Wav.Format

  property "every format survives a round trip, and any bytes are a format or an error" do
    forall {rate, channels, sample, junk} <-
             {integer(1, 192_000), integer(1, 16), one_of(AudioFormat.sample_types()), binary()} do
      format = AudioFormat.pcm(rate, channels, sample)

      Format.parse_chunk(Format.encode_chunk(format)) == {:ok, format} and
        match?({tag, _} when tag in [:ok, :error], Format.parse_chunk(junk))
    end
  end
end
