defmodule Situ.Test.Examples do
  @moduledoc """
  Finds public functions without an example. `h Situ.join` is where people look first.

      iex> Situ.Test.Examples.list_missing(Situ.Test.Examples)
      []
  """

  @doc """
  Returns the public functions of a module whose documentation has no doctest.

      iex> Situ.Test.Examples.list_missing(Situ.Time) |> Enum.member?("Situ.Time.ms/1")
      true
  """
  @spec list_missing(module()) :: [String.t()]
  def list_missing(module) do
    {:docs_v1, _, _, _, _, _, docs} = Code.fetch_docs(module)

    for {{:function, name, arity}, _, _, doc, _} <- docs,
        doc != :hidden,
        not example?(doc),
        do: "#{inspect(module)}.#{name}/#{arity}"
  end

  defp example?(%{"en" => text}), do: text =~ "iex> "
  defp example?(:none), do: false
end
