defmodule Situ.Bridge.Psi.Media do
  @moduledoc false
  # \psi's pictures and sound as ours. Rows and samples lie in memory alike, so that nothing is converted.

  @formats %{
    1 => :gray8,
    2 => :gray16,
    3 => :bgr24,
    4 => :bgrx32,
    5 => :bgra32,
    6 => :rgba64,
    7 => :rgb24
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

  @doc "Our type for one of \\psi's, or nil."
  @spec type(String.t()) :: Situ.Type.t() | nil
  def type("Microsoft.Psi.Imaging." <> name)
      when name in ["Image", "DepthImage", "EncodedImage", "EncodedDepthImage"],
      do: :map

  def type("Microsoft.Psi.Audio.AudioBuffer"), do: :map
  def type(_name), do: nil

  @doc "The value of one of the shapes, out of its members; the members where they make no sense."
  @spec value(atom(), map()) :: term()
  def value(:image, %{"image" => data, "width" => w, "height" => h, "stride" => stride} = fields) do
    case @formats[fields["pixelFormat"]] do
      nil -> fields
      format -> %{width: w, height: h, stride: stride, format: format, data: data}
    end
  end

  def value(
        :depth_image,
        %{"image" => data, "width" => w, "height" => h, "stride" => stride} = fields
      ) do
    Map.merge(%{width: w, height: h, stride: stride, data: data}, depth(fields))
  end

  def value(:encoded_image, %{"stream" => data, "Width" => w, "Height" => h} = fields)
      when is_binary(data) do
    case sniff(data) do
      nil -> fields
      format -> %{width: w, height: h, format: format, data: data}
    end
  end

  def value(:audio, %{"format" => %{"FormatTag" => tag} = wave, "data" => data} = fields)
      when is_binary(data) do
    case @samples[{tag, wave["BitsPerSample"]}] do
      nil ->
        fields

      sample ->
        format = %{rate: wave["SamplesPerSec"], channels: wave["Channels"], sample: sample}
        %{format: format, data: data}
    end
  end

  def value(_shape, fields), do: fields

  defp depth(fields) do
    semantics = if (fields["depthValueSemantics"] || 0) == 1, do: :point, else: :plane
    %{semantics: semantics, scale: fields["depthValueToMetersScaleFactor"] || 0.001}
  end

  defp sniff(<<0xFF, 0xD8, 0xFF, _::binary>>), do: :jpeg
  defp sniff(<<0x89, "PNG", _::binary>>), do: :png
  defp sniff(_), do: nil
end
