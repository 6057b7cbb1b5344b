defmodule Situ.Bridge.Format.MessagePack do
  @moduledoc false
  # Encodes messages as MessagePack; a file consists of frames and ends with a length of 0.
  @behaviour Situ.Bridge.Format
  alias Situ.Bridge.Format.{LengthPrefixed, TimeFormat, Value}
  alias Situ.Bridge.MessagePack

  # Ticks are 100 ns, so the remaining nanoseconds are in a separate member.
  @impl true
  def encode(value, time) do
    {ticks, rest} = TimeFormat.to_ticks(time)
    extra = if rest == 0, do: [], else: [{"nanoseconds", rest}]
    MessagePack.encode({[{"message", convert_value(value)}, {"originatingTime", ticks}] ++ extra})
  end

  defp convert_value(value) when value in [:nan, :infinity, :neg_infinity], do: value
  defp convert_value(list) when is_list(list), do: Enum.map(list, &convert_value/1)
  defp convert_value(%_{} = struct), do: Value.to_plain(struct, :keep_bytes)

  defp convert_value(map) when is_map(map),
    do: Map.new(map, fn {k, v} -> {k, convert_value(v)} end)

  defp convert_value({pairs}) when is_list(pairs),
    do: {Enum.map(pairs, fn {k, v} -> {k, convert_value(v)} end)}

  defp convert_value(tuple) when is_tuple(tuple), do: tuple |> Tuple.to_list() |> convert_value()
  defp convert_value(other), do: other

  @impl true
  def decode(bytes, opts) do
    with {:ok, {pairs}, ""} <- MessagePack.decode(bytes, objects: :pairs),
         {:ok, ticks} when is_integer(ticks) <- Value.fetch_member(pairs, "originatingTime"),
         {:ok, value} <- Value.fetch_member(pairs, "message") do
      {:ok,
       {TimeFormat.from_ticks(ticks) + extra_nanoseconds(pairs), Value.shape_objects(value, opts)}}
    else
      {:error, why} -> {:error, why}
      {:ok, _, _} -> {:error, "it is not a map, or bytes follow it"}
      _ -> {:error, "it has no message or no originatingTime in ticks"}
    end
  end

  defp extra_nanoseconds(pairs) do
    case Value.fetch_member(pairs, "nanoseconds") do
      {:ok, n} when n in 0..99 -> n
      _ -> 0
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
