defmodule Situ.Media.Wav.FormatTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.AudioFormat
  alias Situ.Media.Wav.Format
  doctest Situ.Media.Wav.Format

  property "every format comes back; any bytes are a format or an error" do
    forall {rate, channels, sample, junk} <-
             {integer(1, 192_000), integer(1, 16), one_of(AudioFormat.samples()), binary()} do
      format = AudioFormat.pcm(rate, channels, sample)

      Format.parse(Format.encode(format)) == {:ok, format} and
        match?({tag, _} when tag in [:ok, :error], Format.parse(junk))
    end
  end
end
