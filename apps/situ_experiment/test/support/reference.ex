defmodule Situ.Experiment.Test.Reference do
  @moduledoc false
  # Reads inputs and values that another library computed once. The files name the library and its version.

  @doc "Returns the content of `test/data/NAME.json`."
  def read(name) do
    {:ok, data} =
      Path.expand("../data/#{name}.json", __DIR__) |> File.read!() |> Situ.JSON.decode()

    data
  end

  @doc "Returns whether two numbers are equal, apart from rounding."
  def close?(a, b), do: abs(a - b) <= 1.0e-9 * max(1.0, abs(b))
end
