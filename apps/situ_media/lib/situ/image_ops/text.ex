defmodule Situ.ImageOps.Text do
  @moduledoc false
  # Validates text for the native side and adds the font files to search.

  alias Situ.{Error, Image}
  alias Situ.Image.Color
  alias Situ.Media.NativeKernel

  @drawn [color: :red, size: 16, font: nil, background: nil]
  @measured [size: 16, font: nil]

  # Laying out and drawing a character takes about 5 us, and reading a font file for the first time takes 1 ms, so
  # text is always drawn on a dirty scheduler.
  @cost_us 500

  @spec cost_us() :: pos_integer()
  def cost_us, do: @cost_us

  @spec text_term({float(), float()}, String.t(), keyword(), Image.Format.t()) :: tuple()
  def text_term({x, y}, text, opts, format) when is_binary(text) do
    opts = Keyword.validate!(opts, @drawn)
    background = opts[:background] && Color.to_opencv_scalar(format, opts[:background])
    place = {x, y, font_size(opts)}

    {:text, place, Color.to_opencv_scalar(format, opts[:color]), background, text,
     font_paths(opts[:font])}
  end

  def text_term(_at, other, _opts, _format),
    do: raise(ArgumentError, "text to draw must be a string, got: #{inspect(other)}")

  @doc "Checks that all text is UTF-8, which the native side requires."
  @spec check_utf8([tuple()]) :: :ok | {:error, Error.t()}
  def check_utf8(terms) do
    case Enum.find(terms, &(elem(&1, 0) == :text and not String.valid?(elem(&1, 4)))) do
      nil -> :ok
      term -> {:error, not_utf8(elem(term, 4))}
    end
  end

  @spec measure_size(String.t(), keyword()) :: {:ok, {float(), float()}} | {:error, Error.t()}
  def measure_size(text, opts) when is_binary(text) do
    opts = Keyword.validate!(opts, @measured)

    if String.valid?(text),
      do:
        NativeKernel.run_image(
          {:measure_text, text, font_size(opts), font_paths(opts[:font])},
          @cost_us
        ),
      else: {:error, not_utf8(text)}
  end

  defp not_utf8(text) do
    Error.new(:bad_option, "text to draw must be UTF-8, got: #{inspect(text, limit: 20)}",
      fix: "decode it first, for example :unicode.characters_to_binary(text, :latin1)"
    )
  end

  defp font_size(opts) do
    case opts[:size] do
      size when is_number(size) -> size * 1.0
      other -> raise ArgumentError, "size: must be a number of pixels, got: #{inspect(other)}"
    end
  end

  # The default font provides characters that the requested fonts do not cover.
  defp font_paths(nil), do: [default_font()]
  defp font_paths(path) when is_binary(path), do: [path, default_font()]

  defp font_paths([_ | _] = paths) do
    unless Enum.all?(paths, &is_binary/1), do: bad_font(paths)
    paths ++ [default_font()]
  end

  defp font_paths(other), do: bad_font(other)

  defp bad_font(other) do
    raise ArgumentError, "font: must be a path or a list of paths, got: #{inspect(other)}"
  end

  defp default_font, do: Application.app_dir(:situ_media, "priv/fonts/DejaVuSans.ttf")
end
