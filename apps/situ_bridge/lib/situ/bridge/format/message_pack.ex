defmodule Situ.Bridge.Format.MessagePack do
  @moduledoc false
  # Messages as MessagePack; a file has frames, and a length of 0 at its end.
  @behaviour Situ.Bridge.Format
  alias Situ.Bridge.Format.{Stamp, Value}
  alias Situ.Bridge.MessagePack

  @most 64 * 1024 * 1024

  # Nanoseconds that no tick tells stand beside it.
  @impl true
  def encode(value, time) do
    {ticks, rest} = Stamp.to_ticks(time)
    fine = if rest == 0, do: [], else: [{"nanoseconds", rest}]
    MessagePack.encode({[{"message", value(value)}, {"originatingTime", ticks}] ++ fine})
  end

  defp value(value) when value in [:nan, :infinity, :neg_infinity], do: value
  defp value(list) when is_list(list), do: Enum.map(list, &value/1)
  defp value(%_{} = struct), do: Value.plain(struct)
  defp value(map) when is_map(map), do: Map.new(map, fn {k, v} -> {k, value(v)} end)
  defp value({pairs}) when is_list(pairs), do: {Enum.map(pairs, fn {k, v} -> {k, value(v)} end)}
  defp value(tuple) when is_tuple(tuple), do: tuple |> Tuple.to_list() |> value()
  defp value(other), do: other

  @impl true
  def decode(bytes, opts) do
    with {:ok, {pairs}, ""} <- MessagePack.decode(bytes, objects: :pairs),
         {:ok, ticks} when is_integer(ticks) <- Value.fetch(pairs, "originatingTime"),
         {:ok, value} <- Value.fetch(pairs, "message") do
      {:ok, {Stamp.from_ticks(ticks) + fine(pairs), Value.shaped(value, opts)}}
    else
      {:error, why} -> {:error, why}
      {:ok, _, _} -> {:error, "it is no map, or has bytes left over"}
      _ -> {:error, "it has no message or no originatingTime in ticks"}
    end
  end

  defp fine(pairs) do
    case Value.fetch(pairs, "nanoseconds") do
      {:ok, n} when n in 0..99 -> n
      _ -> 0
    end
  end

  @impl true
  def record(value, time, _n) do
    bytes = value |> encode(time) |> IO.iodata_to_binary()
    [<<byte_size(bytes)::little-32>>, bytes]
  end

  @impl true
  def finish(_n), do: <<0::32>>
  @impl true
  def start, do: :open

  @impl true
  def split(_bytes, :ended, _last?, _opts), do: {:ok, [], {"", :ended}}
  def split(bytes, :open, _last?, opts), do: frames(bytes, opts, [])

  defp frames(<<0::32, _::binary>>, _opts, found), do: {:ok, Enum.reverse(found), {"", :ended}}

  defp frames(<<n::little-32, _::binary>>, _opts, []) when n > @most,
    do: {:error, "a frame of #{n} bytes"}

  defp frames(<<n::little-32, _::binary>> = bytes, _opts, found) when n > @most,
    do: {:ok, Enum.reverse(found), {bytes, :open}}

  defp frames(<<n::little-32, frame::binary-size(n), rest::binary>> = bytes, opts, found) do
    case decode(frame, opts) do
      {:ok, timed} -> frames(rest, opts, [timed | found])
      {:error, why} when found == [] -> {:error, why}
      {:error, _} -> {:ok, Enum.reverse(found), {bytes, :open}}
    end
  end

  defp frames(rest, _opts, found), do: {:ok, Enum.reverse(found), {rest, :open}}
end
