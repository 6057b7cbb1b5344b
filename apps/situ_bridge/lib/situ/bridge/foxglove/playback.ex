defmodule Situ.Bridge.Foxglove.Playback do
  @moduledoc false
  # The playback position of a recording. `now` is a monotonic clock in nanoseconds. Pure.
  #
  # Only `advance/2` moves the position with the clock, and by at most `@max_step` per call: while a client reads
  # nothing, its playback waits for it.

  @max_step 250_000_000
  @max_speed 1_000.0

  @enforce_keys [:from, :to, :at]
  defstruct [:from, :to, :at, :clock, speed: 1.0, paused?: false]
  @type t :: %__MODULE__{}

  @spec new(Situ.Time.t(), Situ.Time.t()) :: t()
  def new(from, to), do: %__MODULE__{from: from, to: to, at: from - 1}

  @doc "Advances the position to clock time `now`."
  @spec advance(t(), integer()) :: t()
  def advance(%{clock: clock} = p, now) when clock == nil or p.paused?, do: %{p | clock: now}

  def advance(p, now) do
    elapsed = min(now - p.clock, @max_step)
    %{p | at: min(p.at + round(elapsed * p.speed), p.to), clock: now}
  end

  @doc "Moves the position back to a time that was reached; later messages wait."
  @spec rewind_to(t(), Situ.Time.t()) :: t()
  def rewind_to(p, time), do: %{p | at: min(p.at, time)}

  @spec seek(t(), Situ.Time.t()) :: t()
  def seek(p, time), do: %{p | at: time |> max(p.from) |> min(p.to)}

  @doc "Plays at the given speed, at most 1,000 times real time; a speed of 0 keeps the current one."
  @spec play(t(), number()) :: t()
  def play(p, speed), do: %{p | paused?: false, speed: limit_speed(p, speed)}

  @spec pause(t()) :: t()
  def pause(p), do: %{p | paused?: true}

  @spec set_speed(t(), number()) :: t()
  def set_speed(p, speed), do: %{p | speed: limit_speed(p, speed)}

  defp limit_speed(_p, speed) when is_number(speed) and speed > 0, do: min(speed / 1, @max_speed)
  defp limit_speed(p, _speed), do: p.speed

  @spec status(t()) :: :playing | :paused | :ended
  def status(%{at: at, to: to}) when at >= to, do: :ended
  def status(%{paused?: true}), do: :paused
  def status(_), do: :playing
end
