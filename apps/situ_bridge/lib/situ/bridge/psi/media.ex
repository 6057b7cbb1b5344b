defmodule Situ.Bridge.Psi.Media do
  @moduledoc false
  # Converts \psi's images and audio to Situ's types. Both have the same memory layout, so no pixels or samples are
  # converted.

  @formats %{
    1 => :gray8,
    2 => :gray16,
    3 => :bgr24,
    4 => :bgrx32,
    5 => :bgra32,
    6 => :rgba64,
    7 => :rgb24,
    # Before version 3 of their schema, images used the numbers of System.Drawing.
    198_659 => :gray8,
    1_052_676 => :gray16,
    137_224 => :bgr24,
    139_273 => :bgrx32,
    2_498_570 => :bgra32,
    3_424_269 => :rgba64
  }

  # {tag, bits}: 1 is PCM, 3 is floating point.
  @samples %{
    {1, 8} => :u8,
    {1, 16} => :s16,
    {1, 24} => :s24,
    {1, 32} => :s32,
    {3, 32} => :f32,
    {3, 64} => :f64
  }

  @max_unpacked 268_435_456

  @types %{
    "Microsoft.Psi.Imaging.Image" => Situ.Image,
    "Microsoft.Psi.Imaging.DepthImage" => Situ.DepthImage,
    "Microsoft.Psi.Imaging.EncodedImage" => Situ.EncodedImage,
    "Microsoft.Psi.Imaging.EncodedDepthImage" => Situ.EncodedImage,
    "Microsoft.Psi.Audio.AudioBuffer" => Situ.AudioBuffer
  }

  @doc "Returns the Situ type of a \\psi type, or nil."
  @spec situ_type(String.t()) :: Situ.Type.t() | nil
  def situ_type(name), do: @types[name]

  @doc "Builds the value of a shape from its members. Returns the members if they are not valid."
  @spec build_value(atom(), map()) :: term()
  def build_value(shape, fields) do
    case build_media(shape, fields) do
      {:ok, value} -> value
      _ -> fields
    end
  end

  defp build_media(:image, %{"image" => data, "pixelFormat" => code} = fields)
       when is_binary(data),
       do:
         fields
         |> image_size()
         |> Keyword.merge(format: @formats[code], data: data)
         |> Situ.Image.new()

  defp build_media(:depth_image, %{"image" => data} = fields) when is_binary(data),
    do: (image_size(fields) ++ depth_options(fields) ++ [data: data]) |> Situ.DepthImage.new()

  # Rows that are compressed with gzip are not an image file, so they are unpacked.
  defp build_media(:encoded_image, %{
         "stream" => <<0x1F, 0x8B, _::binary>> = packed,
         "Width" => w,
         "Height" => h,
         "pixelFormat" => code
       })
       when is_integer(w) and w > 0 and is_integer(h) and h > 0 do
    with {:ok, rows} <-
           Situ.Bridge.Gzip.unpack_limited(packed, min(h * (w * 8 + 64), @max_unpacked)),
         do:
           Situ.Image.new(
             width: w,
             height: h,
             stride: div(byte_size(rows), h),
             format: @formats[code],
             data: rows
           )
  end

  defp build_media(:encoded_image, %{"stream" => data, "Width" => w, "Height" => h})
       when is_binary(data) do
    with {:ok, format} <- Situ.EncodedImage.detect_format(data),
         do: Situ.EncodedImage.new(format: format, width: w, height: h, data: data)
  end

  defp build_media(:audio, %{"format" => %{"FormatTag" => tag} = wave, "data" => data})
       when is_binary(data) do
    sample = @samples[{tag, wave["BitsPerSample"]}]
    format = [rate: wave["SamplesPerSec"], channels: wave["Channels"], sample: sample]

    with {:ok, format} <- Situ.AudioFormat.new(format),
         do: Situ.AudioBuffer.new(format: format, data: data)
  end

  defp build_media(_shape, _fields), do: :error

  defp image_size(fields),
    do: [width: fields["width"], height: fields["height"], stride: fields["stride"]]

  defp depth_options(fields) do
    semantics = if (fields["depthValueSemantics"] || 0) == 1, do: :point, else: :plane
    [semantics: semantics, scale: fields["depthValueToMetersScaleFactor"] || 0.001]
  end
end
