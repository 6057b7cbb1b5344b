defmodule Situ.Time do
  @moduledoc """
  Time points and durations as integer nanoseconds.

  A time point is the number of nanoseconds since the Unix epoch, UTC, as returned by `System.os_time(:nanosecond)`. A
  duration is a number of nanoseconds. Both are integers, so times from ROS and MCAP and 100 ns ticks keep full
  precision.

      iex> Situ.Time.ms(250)
      250_000_000
      iex> Situ.Time.to_iso8601(Situ.Time.s(1))
      "1970-01-01T00:00:01.000000000Z"
  """

  @typedoc "A time point: nanoseconds since the Unix epoch, UTC."
  @type t :: integer()
  @typedoc "A duration in nanoseconds."
  @type duration :: integer()

  @doc "Returns nanoseconds unchanged, for readability: `Situ.Time.ns(5)`."
  @spec ns(integer()) :: duration()
  def ns(n) when is_integer(n), do: n

  @doc "Converts microseconds to nanoseconds, rounded to the nearest."
  @spec us(number()) :: duration()
  def us(n), do: scale_to_ns(n, 1_000)

  @doc "Converts milliseconds to nanoseconds, rounded to the nearest."
  @spec ms(number()) :: duration()
  def ms(n), do: scale_to_ns(n, 1_000_000)

  @doc "Converts seconds to nanoseconds, rounded to the nearest."
  @spec s(number()) :: duration()
  def s(n), do: scale_to_ns(n, 1_000_000_000)

  @doc "Converts minutes to nanoseconds."
  @spec min(number()) :: duration()
  def min(n), do: scale_to_ns(n, 60_000_000_000)

  @doc "Converts hours to nanoseconds."
  @spec h(number()) :: duration()
  def h(n), do: scale_to_ns(n, 3_600_000_000_000)

  @doc """
  Converts ticks of 100 ns, the time unit of \\\\psi, to nanoseconds.

      iex> Situ.Time.ticks(3)
      300
  """
  @spec ticks(integer()) :: duration()
  def ticks(n) when is_integer(n), do: n * 100

  @doc """
  Converts nanoseconds to seconds.

      iex> Situ.Time.to_seconds(Situ.Time.ms(250))
      0.25
  """
  @spec to_seconds(t()) :: float()
  def to_seconds(ns) when is_integer(ns), do: ns / 1.0e9

  @doc "Returns the current wall clock time. Pipelines use their own clock instead (`Situ.Pipeline.now/1`)."
  @spec now() :: t()
  def now, do: :os.system_time()

  @doc """
  Formats a time point as ISO 8601 with nine decimals.

      iex> Situ.Time.to_iso8601(1_500_000_000)
      "1970-01-01T00:00:01.500000000Z"
      iex> Situ.Time.to_iso8601(-1)
      "1969-12-31T23:59:59.999999999Z"
  """
  @spec to_iso8601(t()) :: String.t()
  def to_iso8601(time) when is_integer(time) do
    seconds = Integer.floor_div(time, 1_000_000_000)
    digits = time |> Integer.mod(1_000_000_000) |> Integer.to_string()

    <<format_date(seconds)::binary, ?., :binary.copy("0", 9 - byte_size(digits))::binary,
      digits::binary, ?Z>>
  end

  @day 86_400

  # A fast path for 1970 to 9999. It counts days in 400-year eras that begin on March 1.
  defp format_date(seconds) when seconds in 0..253_402_300_799 do
    {days, second} = {div(seconds, @day), rem(seconds, @day)}
    days = days + 719_468
    {era, day} = {div(days, 146_097), rem(days, 146_097)}
    year = div(day - div(day, 1_460) + div(day, 36_524) - div(day, 146_096), 365)
    of_year = day - (365 * year + div(year, 4) - div(year, 100))
    month = div(5 * of_year + 2, 153)
    day = of_year - div(153 * month + 2, 5) + 1
    {month, carry} = if month < 10, do: {month + 3, 0}, else: {month - 9, 1}
    year = year + era * 400 + carry
    {hour, minute, second} = {div(second, 3_600), rem(div(second, 60), 60), rem(second, 60)}

    <<Integer.to_string(year)::binary, ?-, two_digits(month)::16, ?-, two_digits(day)::16, ?T,
      two_digits(hour)::16, ?:, two_digits(minute)::16, ?:, two_digits(second)::16>>
  end

  defp format_date(seconds),
    do: seconds |> DateTime.from_unix!() |> DateTime.to_naive() |> NaiveDateTime.to_iso8601()

  # Returns two digits as a 16-bit integer of two characters.
  defp two_digits(n), do: (div(n, 10) + ?0) * 256 + rem(n, 10) + ?0

  @doc """
  Parses ISO 8601 with any number of decimals; digits after the ninth are ignored.

      iex> Situ.Time.parse("1970-01-01T00:00:01.5Z")
      {:ok, 1_500_000_000}
      iex> {:error, error} = Situ.Time.parse("yesterday")
      iex> error.code
      :bad_time
  """
  @spec parse(String.t()) :: {:ok, t()} | {:error, Situ.Error.t()}
  def parse(text) when is_binary(text) do
    with [_, whole, fraction, zone] <-
           Regex.run(~r/^([^.]+?)(?:\.(\d+))?(Z|[+-]\d\d:?\d\d)?$/, text <> "", capture: :all)
           |> pad_groups(),
         {:ok, date, _} <- DateTime.from_iso8601(whole <> if(zone == "", do: "Z", else: zone)) do
      digits = fraction |> String.slice(0, 9) |> String.pad_trailing(9, "0")
      {:ok, DateTime.to_unix(date) * 1_000_000_000 + String.to_integer(digits)}
    else
      _ ->
        {:error,
         Situ.Error.new(:bad_time, "not a time: #{inspect(text)}",
           fix: "write it like 2026-01-31T12:34:56.789Z"
         )}
    end
  end

  @duration_units %{
    "ns" => 1,
    "us" => 1_000,
    "ms" => 1_000_000,
    "s" => 1_000_000_000,
    "m" => 60_000_000_000,
    "min" => 60_000_000_000,
    "h" => 3_600_000_000_000
  }

  @doc """
  Parses a duration: a number with the unit `ns`, `us`, `ms`, `s`, `m` or `min`, or `h`. A number without a unit is in
  seconds.

      iex> Enum.map(["250ms", "1.5 min", "2"], &Situ.Time.parse_duration/1)
      [{:ok, 250_000_000}, {:ok, 90_000_000_000}, {:ok, 2_000_000_000}]
      iex> Situ.Time.parse_duration("soon")
      :error
  """
  @spec parse_duration(String.t()) :: {:ok, duration()} | :error
  def parse_duration(text) when is_binary(text) do
    with {number, unit} <- Float.parse(text),
         unit = unit |> String.trim() |> default_unit(),
         {:ok, ns} <- Map.fetch(@duration_units, unit) do
      {:ok, round(number * ns)}
    else
      _ -> :error
    end
  end

  defp default_unit(""), do: "s"
  defp default_unit(unit), do: unit

  @doc """
  Formats a duration for people, with three significant digits and a unit.

      iex> Situ.Time.format_duration(1_234_567)
      "1.23 ms"
      iex> Situ.Time.format_duration(95_000_000_000)
      "1 min 35 s"
      iex> Situ.Time.format_duration(60 * 24 * 3_600_000_000_000)
      "60 d 0 h"
  """
  @spec format_duration(duration()) :: String.t()
  def format_duration(ns) when ns < 0, do: "-" <> format_duration(-ns)
  def format_duration(ns) when ns < 1_000, do: "#{ns} ns"
  def format_duration(ns) when ns < 1_000_000, do: significant_digits(ns / 1.0e3) <> " us"
  def format_duration(ns) when ns < 1_000_000_000, do: significant_digits(ns / 1.0e6) <> " ms"
  def format_duration(ns) when ns < 60_000_000_000, do: significant_digits(ns / 1.0e9) <> " s"

  def format_duration(ns) when ns < 3_600_000_000_000 do
    seconds = div(ns, 1_000_000_000)
    "#{div(seconds, 60)} min #{rem(seconds, 60)} s"
  end

  def format_duration(ns) when ns < 2 * 86_400_000_000_000 do
    minutes = div(ns, 60_000_000_000)
    "#{div(minutes, 60)} h #{rem(minutes, 60)} min"
  end

  def format_duration(ns) do
    hours = div(ns, 3_600_000_000_000)
    "#{div(hours, 24)} d #{rem(hours, 24)} h"
  end

  defp scale_to_ns(n, unit) when is_integer(n), do: n * unit
  defp scale_to_ns(n, unit) when is_float(n), do: round(n * unit)

  defp significant_digits(value) when value >= 100,
    do: :erlang.float_to_binary(value, decimals: 0)

  defp significant_digits(value) when value >= 10, do: :erlang.float_to_binary(value, decimals: 1)
  defp significant_digits(value), do: :erlang.float_to_binary(value, decimals: 2)

  # `Regex.run/3` omits trailing groups that did not match.
  defp pad_groups(nil), do: nil
  defp pad_groups([all, whole]), do: [all, whole, "", ""]
  defp pad_groups([all, whole, fraction]), do: [all, whole, fraction, ""]
  defp pad_groups(groups), do: groups
end
