defmodule Situ.Infer.Track.Kalman do
  @moduledoc false
  # A Kalman filter for a measured number whose velocity changes slowly. The state consists of the
  # value and its velocity. Pure; times are in seconds.
  #
  # The acceleration is white noise (Bar-Shalom, Li and Kirubarajan, "Estimation with Applications
  # to Tracking and Navigation", 2001, 6.3.2).
  @enforce_keys [:value, :velocity, :p]
  defstruct [:value, :velocity, :p]

  @typedoc "`p` is the covariance, `{value, both, velocity}`: two variances and, between them, their covariance."
  @type t :: %__MODULE__{value: float(), velocity: float(), p: {float(), float(), float()}}

  @doc """
  Builds the state after one measurement, with the standard deviations of its error and of the
  velocity (mean 0).

      iex> alias Situ.Infer.Track.Kalman
      iex> k = Kalman.new(0.0, 1.0, 10.0)
      iex> k = Enum.reduce(1..50, k, fn i, k -> k |> Kalman.predict(0.1, 1.0) |> Kalman.correct(i * 0.5, 1.0) end)
      iex> {abs(k.value - 25.0) < 0.1, abs(k.velocity - 5.0) < 0.1}
      {true, true}
  """
  @spec new(float(), float(), float()) :: t()
  def new(value, error, speed),
    do: %__MODULE__{value: value, velocity: 0.0, p: {error * error, 0.0, speed * speed}}

  @doc "Predicts the state `dt` seconds later; `noise` is the standard deviation of the acceleration."
  @spec predict(t(), float(), float()) :: t()
  def predict(%__MODULE__{p: {a, b, c}} = k, dt, noise) do
    q = noise * noise
    a = a + 2 * dt * b + dt * dt * c + q * dt * dt * dt / 3
    b = b + dt * c + q * dt * dt / 2
    %{k | value: k.value + dt * k.velocity, p: {a, b, c + q * dt}}
  end

  @doc "Corrects the state with a measurement whose error has this standard deviation."
  @spec correct(t(), float(), float()) :: t()
  def correct(%__MODULE__{p: {a, b, c}} = k, measured, error) do
    s = a + error * error
    {g, h} = {a / s, b / s}
    off = measured - k.value

    %{
      k
      | value: k.value + g * off,
        velocity: k.velocity + h * off,
        p: {(1 - g) * a, (1 - g) * b, c - h * b}
    }
  end
end
