defmodule Situ.Test.Eventually do
  @moduledoc """
  Waits for an event that does not send a message, such as a new file, the exit of an operating system process or a
  rendered page. Polls every few milliseconds for up to 30 s; only a failing test waits that long.

      import Situ.Test.Eventually
      assert eventually(fn -> File.exists?(path) end)
  """

  @doc """
  Returns the first value of `fun` that is neither `nil` nor `false`, or the last value after `within` ms.

      iex> Situ.Test.Eventually.eventually(fn -> 7 end)
      7
      iex> Situ.Test.Eventually.eventually(fn -> nil end, 5)
      nil
  """
  @spec eventually((() -> value), non_neg_integer()) :: value when value: term()
  def eventually(fun, within \\ 30_000), do: poll_until(fun, monotonic_ms() + within)

  defp poll_until(fun, till) do
    value = fun.()

    if value || monotonic_ms() > till do
      value
    else
      receive do
      after
        5 -> poll_until(fun, till)
      end
    end
  end

  defp monotonic_ms, do: System.monotonic_time(:millisecond)
end
