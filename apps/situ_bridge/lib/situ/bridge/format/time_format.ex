defmodule Situ.Bridge.Format.TimeFormat do
  @moduledoc false
  # Converts originating times to the notations of other systems: ISO 8601 with seven decimals, or ticks of 100 ns
  # since the year 1.

  @epoch 621_355_968_000_000_000

  @doc """
  Formats a time as ISO 8601 with seven decimals, or nine if the time is not a multiple of 100 ns.

      iex> Situ.Bridge.Format.TimeFormat.to_iso8601(1_234_567_800)
      "1970-01-01T00:00:01.2345678Z"
      iex> Situ.Bridge.Format.TimeFormat.to_iso8601(-1)
      "1969-12-31T23:59:59.999999999Z"
  """
  @spec to_iso8601(Situ.Time.t()) :: String.t()
  def to_iso8601(time) do
    text = Situ.Time.to_iso8601(time)
    if rem(time, 100) == 0, do: String.replace_suffix(text, "00Z", "Z"), else: text
  end

  @doc "Returns the ticks since the year 1 and the remaining nanoseconds."
  @spec to_ticks(Situ.Time.t()) :: {integer(), 0..99}
  def to_ticks(time), do: {Integer.floor_div(time, 100) + @epoch, Integer.mod(time, 100)}

  @doc """
  Converts ticks since the year 1 to a time.

      iex> Situ.Bridge.Format.TimeFormat.from_ticks(621_355_968_000_000_001)
      100
  """
  @spec from_ticks(integer()) :: Situ.Time.t()
  def from_ticks(ticks), do: (ticks - @epoch) * 100
end
