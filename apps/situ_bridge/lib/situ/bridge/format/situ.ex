defmodule Situ.Bridge.Format.Situ do
  @moduledoc false
  # Messages as Situ's stores have them: the time (signed, 64 bits, little-endian), the length and the letters of a
  # codec's name, and its bytes (`Situ.Codec`: pictures, sound, clouds ...); without a name an external term, checked as
  # terms out of files are.
  @behaviour Situ.Bridge.Format
  alias Situ.Bridge.Format.Frames
  alias Situ.Store.{Codecs, Terms}

  @impl true
  def encode(value, time) do
    {name, payload} = payload(value, Codecs.of(value))
    [<<time::little-signed-64, byte_size(name), name::binary>>, payload]
  end

  defp payload(value, nil) do
    case Terms.encode(value) do
      {:ok, bytes} -> {"", bytes}
      {:error, _} -> throw({:not_writable, value})
    end
  end

  defp payload(value, codec), do: {codec.codec_name(), codec.encode(value)}

  @impl true
  def decode(<<time::little-signed-64, n, name::binary-size(n), payload::binary>>, _opts) do
    with {:ok, value} <- value(name, payload), do: {:ok, {time, value}}
  end

  def decode(_bytes, _opts), do: {:error, "it is too short"}

  defp value("", term), do: Terms.decode(term)

  defp value(name, payload) do
    case Codecs.find(name, nil) do
      nil ->
        {:error, "no codec #{inspect(name)} is known"}

      codec ->
        with {:error, why} <- codec.decode(payload),
             do: {:error, "as #{name} it is #{inspect(why)}"}
    end
  end

  @impl true
  def record(value, time, _n), do: value |> encode(time) |> Frames.frame()
  @impl true
  def finish(_n), do: Frames.finish()
  @impl true
  def start, do: Frames.start()
  @impl true
  def split(bytes, state, _last?, opts), do: Frames.split(bytes, state, &decode(&1, opts))
end
