defmodule Situ.Media.Recording.CodecName do
  @moduledoc false
  # Translates FFmpeg's description of a codec to the form of WebCodecs: its name (RFC 6381), and the setup data that a
  # decoder needs in addition to the packets. The setup data is that of MP4 files: an avcC, hvcC, vpcC or av1C record.
  import Bitwise

  @doc """
  Returns the name and the setup data of a codec, or `:error` if no browser decodes it. `profile` and `pixels` are the
  profile and the pixel format that ffprobe states.

      iex> alias Situ.Media.Recording.CodecName
      iex> CodecName.translate("h264", <<1, 0x64, 0, 0x28, 0xFF>>, "High", "yuv420p")
      {:ok, "avc1.640028", <<1, 0x64, 0, 0x28, 0xFF>>}
      iex> CodecName.translate("h264", <<0, 0, 0, 1, 0x67, 0x42, 0xC0, 0x1E, 0xDA>>, "Baseline", "yuv420p")
      {:ok, "avc1.42c01e", ""}
      iex> CodecName.translate("vp9", "", "Profile 2", "yuv420p10le")
      {:ok, "vp09.02.62.10", ""}
      iex> CodecName.translate("av1", <<0x81, 0x08, 0x0C, 0>>, "Main", "yuv420p")
      {:ok, "av01.0.08M.08", ""}
      iex> hvcc = <<1, 1, 0x60, 0, 0, 0, 0x90, 0, 0, 0, 0, 0, 0x5D, 0xF0>>
      iex> CodecName.translate("hevc", hvcc, "Main", "yuv420p")
      {:ok, "hvc1.1.6.L93.90", hvcc}
      iex> {CodecName.translate("mjpeg", "", "Baseline", "yuvj420p"), CodecName.translate("mpeg4", "", "", "")}
      {{:ok, "jpeg", ""}, :error}
  """
  @spec translate(String.t(), binary(), String.t(), String.t()) ::
          {:ok, String.t(), binary()} | :error
  def translate("h264", <<1, profile::binary-size(3), _::binary>> = setup, _profile, _pixels),
    do: {:ok, "avc1." <> encode_hex(profile), setup}

  # Without a record, the parameters are in the packets (Annex B).
  def translate("h264", setup, _profile, _pixels) do
    case Regex.run(~r/\x00\x00\x01[\x07\x27\x47\x67](...)/s, setup) do
      [_, profile] -> {:ok, "avc1." <> encode_hex(profile), ""}
      nil -> :error
    end
  end

  def translate(
        "hevc",
        <<1, space::2, tier::1, profile::5, compatible::32, rest::binary>> = setup,
        _,
        _
      ) do
    case rest do
      <<constraints::binary-size(6), level, _::binary>> ->
        name = [
          "#{Enum.at(["", "A", "B", "C"], space)}#{profile}",
          compatible |> reverse_bits() |> Integer.to_string(16),
          "#{if tier == 1, do: "H", else: "L"}#{level}"
          | constraint_bytes(constraints)
        ]

        {:ok, "hvc1." <> Enum.join(name, "."), setup}

      _ ->
        :error
    end
  end

  def translate("av1", <<_version, profile::3, level::5, tier::1, depth::2, _::bits>>, _, _) do
    tier = if tier == 1, do: "H", else: "M"
    bits = Enum.at(["08", "10", "12", "12"], if(depth == 0b11, do: 2, else: depth >>> 1))
    {:ok, "av01.#{profile}.#{two_digits(level)}#{tier}.#{bits}", ""}
  end

  def translate("vp8", _setup, _profile, _pixels), do: {:ok, "vp8", ""}

  # FFmpeg does not know the level. The highest one permits every size.
  def translate("vp9", _setup, "Profile " <> profile, pixels) when profile in ~w(0 1 2 3),
    do: {:ok, "vp09.0#{profile}.62.#{bit_depth(pixels)}", ""}

  def translate("mjpeg", _setup, _profile, _pixels), do: {:ok, "jpeg", ""}
  def translate("png", _setup, _profile, _pixels), do: {:ok, "png", ""}
  def translate(_codec, _setup, _profile, _pixels), do: :error

  defp encode_hex(bytes), do: Base.encode16(bytes, case: :lower)
  defp two_digits(n), do: n |> Integer.to_string() |> String.pad_leading(2, "0")

  defp reverse_bits(n), do: for(i <- 0..31, reduce: 0, do: (all -> all <<< 1 ||| (n >>> i &&& 1)))

  # Trailing zero bytes are left out.
  defp constraint_bytes(bytes) do
    for <<byte <- String.trim_trailing(bytes, <<0>>)>>, do: Integer.to_string(byte, 16)
  end

  defp bit_depth(pixels) do
    cond do
      String.contains?(pixels, "12le") -> "12"
      String.contains?(pixels, "10le") -> "10"
      true -> "08"
    end
  end

  @doc """
  Reads a hexadecimal dump of ffprobe.

      iex> Situ.Media.Recording.CodecName.parse_dump("\\n00000000: 0164 0028 ff  .d.(.\\n")
      <<1, 0x64, 0, 0x28, 0xFF>>
  """
  @spec parse_dump(String.t()) :: binary()
  def parse_dump(text) do
    for line <- String.split(text, "\n"),
        [_, digits] <- [Regex.run(~r/^[0-9a-f]{8}: ((?:[0-9a-f]{2,4} ?)+) /, line)],
        {:ok, bytes} <- [digits |> String.replace(" ", "") |> Base.decode16(case: :lower)],
        into: <<>>,
        do: bytes
  end
end
