defmodule Situ.Bridge.Format.StoreFormat do
  @moduledoc false
  # Encodes messages in the format of Situ's stores: the time (signed, 64 bits, little-endian) and the value
  # (`Situ.Store.ValueCodec`).
  @behaviour Situ.Bridge.Format
  alias Situ.Bridge.Format.LengthPrefixed
  alias Situ.Store.ValueCodec

  @impl true
  def encode(value, time) do
    case ValueCodec.encode(value) do
      {:ok, bytes} -> [<<time::little-signed-64>>, bytes]
      :error -> throw({:not_writable, value})
    end
  end

  @impl true
  def decode(<<time::little-signed-64, bytes::binary>>, _opts) do
    with {:ok, value} <- ValueCodec.decode(bytes), do: {:ok, {time, value}}
  end

  def decode(_bytes, _opts), do: {:error, "it is too short"}

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
