defmodule Situ.Media.FFmpeg.FormatNames do
  @moduledoc false
  # Maps pixel and sample formats to their names in FFmpeg and their tags in NUT.
  alias Situ.{AudioFormat, Image}

  # {Situ's name, FFmpeg's name, NUT's tag}
  @pixels [
    {:gray8, "gray", "Y800"},
    {:gray16, "gray16le", <<"Y1", 0, 16>>},
    {:bgr24, "bgr24", <<"BGR", 24>>},
    {:rgb24, "rgb24", <<"RGB", 24>>},
    {:bgrx32, "bgr0", <<"BGR", 0>>},
    {:bgra32, "bgra", "BGRA"},
    {:rgba32, "rgba", "RGBA"},
    {:rgba64, "rgba64le", "RBA@"}
  ]

  @samples [
    {:u8, "pcm_u8", <<"PUD", 8>>},
    {:s16, "pcm_s16le", <<"PSD", 16>>},
    {:s24, "pcm_s24le", <<"PSD", 24>>},
    {:s32, "pcm_s32le", <<"PSD", 32>>},
    {:f32, "pcm_f32le", <<"PFD", 32>>},
    {:f64, "pcm_f64le", <<"PFD", 64>>}
  ]

  @spec ffmpeg(Image.Format.t()) :: String.t()
  @spec fourcc(Image.Format.t() | AudioFormat.sample()) :: binary()
  @spec codec(AudioFormat.sample()) :: String.t()
  for {name, ffmpeg, fourcc} <- @pixels do
    def ffmpeg(unquote(name)), do: unquote(ffmpeg)
    def fourcc(unquote(name)), do: unquote(fourcc)
  end

  for {name, codec, fourcc} <- @samples do
    def codec(unquote(name)), do: unquote(codec)
    def fourcc(unquote(name)), do: unquote(fourcc)
  end
end
