defmodule Situ.Bridge.Format.StoreFormat do
  @moduledoc false
  # Encodes messages in the format of Situ's stores: the time (signed, 64 bits, little-endian), the length of a
  # codec's name, the name, and the codec's bytes (`Situ.Codec`: images, audio, point clouds ...). Without a name, the
  # payload is an external term, which is checked like the terms in files.
  @behaviour Situ.Bridge.Format
  alias Situ.Bridge.Format.LengthPrefixed
  alias Situ.Store.{Codecs, TermCodec}

  @impl true
  def encode(value, time) do
    {name, payload} = encode_payload(value, Codecs.module_for(value))
    [<<time::little-signed-64, byte_size(name), name::binary>>, payload]
  end

  defp encode_payload(value, nil) do
    case TermCodec.encode(value) do
      {:ok, bytes} -> {"", bytes}
      {:error, _} -> throw({:not_writable, value})
    end
  end

  defp encode_payload(value, codec), do: {codec.codec_name(), codec.encode(value)}

  @impl true
  def decode(<<time::little-signed-64, n, name::binary-size(n), payload::binary>>, _opts) do
    with {:ok, value} <- decode_payload(name, payload), do: {:ok, {time, value}}
  end

  def decode(_bytes, _opts), do: {:error, "it is too short"}

  defp decode_payload("", term), do: TermCodec.decode(term)

  defp decode_payload(name, payload) do
    case Codecs.find_module(name, nil) do
      nil ->
        {:error, "the codec #{inspect(name)} is unknown"}

      codec ->
        with {:error, why} <- codec.decode(payload),
             do: {:error, "it cannot be decoded as #{name}: #{inspect(why)}"}
    end
  end

  @impl true
  def record(value, time, _n), do: value |> encode(time) |> LengthPrefixed.encode_frame()
  @impl true
  def finish(_n), do: LengthPrefixed.end_marker()
  @impl true
  def start, do: LengthPrefixed.initial_state()
  @impl true
  def split(bytes, state, _last?, opts),
    do: LengthPrefixed.split_frames(bytes, state, &decode(&1, opts))
end
