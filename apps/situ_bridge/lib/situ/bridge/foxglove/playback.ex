defmodule Situ.Bridge.Foxglove.Playback do
  @moduledoc false
  # Where the playback of a recording is. `now` is a clock in nanoseconds that only goes on. Pure.
  #
  # A position moves by `advance/3` only, and in one go no further than `@longest`: while a client takes nothing, its
  # playback waits for it.

  @longest 250_000_000
  @fastest 1_000.0

  @enforce_keys [:from, :to, :at]
  defstruct [:from, :to, :at, :seen, speed: 1.0, paused: false]
  @type t :: %__MODULE__{}

  @spec new(Situ.Time.t(), Situ.Time.t()) :: t()
  def new(from, to), do: %__MODULE__{from: from, to: to, at: from - 1}

  @doc "Moves on to `now`."
  @spec advance(t(), integer()) :: t()
  def advance(%{seen: seen} = p, now) when seen == nil or p.paused, do: %{p | seen: now}

  def advance(p, now) do
    passed = min(now - p.seen, @longest)
    %{p | at: min(p.at + round(passed * p.speed), p.to), seen: now}
  end

  @doc "Goes back to a time that was reached: what is behind it waits."
  @spec only_to(t(), Situ.Time.t()) :: t()
  def only_to(p, time), do: %{p | at: min(p.at, time)}

  @spec seek(t(), Situ.Time.t()) :: t()
  def seek(p, time), do: %{p | at: time |> max(p.from) |> min(p.to)}

  @doc "Plays at a speed, above 0 and at most 1,000 times; 0 leaves it as it is."
  @spec play(t(), number()) :: t()
  def play(p, speed), do: %{p | paused: false, speed: speed(p, speed)}

  @spec pause(t()) :: t()
  def pause(p), do: %{p | paused: true}

  @spec at_speed(t(), number()) :: t()
  def at_speed(p, speed), do: %{p | speed: speed(p, speed)}

  defp speed(_p, speed) when is_number(speed) and speed > 0, do: min(speed / 1, @fastest)
  defp speed(p, _speed), do: p.speed

  @spec status(t()) :: :playing | :paused | :ended
  def status(%{at: at, to: to}) when at >= to, do: :ended
  def status(%{paused: true}), do: :paused
  def status(_), do: :playing
end
