defmodule Situ.Test.Eventually do
  @moduledoc """
  Waits for something that no message tells: a file that appears, a process of the system that ends, a page that has
  drawn. It looks every few milliseconds for 30 s, which only a test that fails waits for, however busy the machine is.

      import Situ.Test.Eventually
      assert eventually(fn -> File.exists?(path) end)
  """

  @doc """
  The first value of `fun` that is neither `nil` nor `false`, or its last one when `within` ms are over.

      iex> Situ.Test.Eventually.eventually(fn -> 7 end)
      7
      iex> Situ.Test.Eventually.eventually(fn -> nil end, 5)
      nil
  """
  @spec eventually((() -> value), non_neg_integer()) :: value when value: term()
  def eventually(fun, within \\ 30_000), do: look(fun, now() + within)

  defp look(fun, till) do
    value = fun.()

    if value || now() > till do
      value
    else
      receive do
      after
        5 -> look(fun, till)
      end
    end
  end

  defp now, do: System.monotonic_time(:millisecond)
end
