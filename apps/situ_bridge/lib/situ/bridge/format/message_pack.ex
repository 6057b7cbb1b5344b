defmodule Situ.Bridge.Format.MessagePack do
  @moduledoc false
  # Encodes messages as MessagePack; a file consists of frames and ends with a length of 0.
  @behaviour Situ.Bridge.Format
  alias Situ.Bridge.Format.{Frames, Stamp, Value}
  alias Situ.Bridge.MessagePack

  # Ticks are 100 ns, so the remaining nanoseconds are in a separate member.
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
      {:ok, _, _} -> {:error, "it is not a map, or bytes follow it"}
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
  def record(value, time, _n), do: value |> encode(time) |> Frames.frame()
  @impl true
  def finish(_n), do: Frames.finish()
  @impl true
  def start, do: Frames.start()
  @impl true
  def split(bytes, state, _last?, opts), do: Frames.split(bytes, state, &decode(&1, opts))
end
