defmodule Situ.Bridge.Format.Fitting do
  @moduledoc false
  # Messages that come with a definition of their own may have the name of a standard one, and other fields: whatever
  # is made of them by the standard's fields is tried, not trusted.

  @doc """
      iex> alias Situ.Bridge.Format.Fitting
      iex> {Fitting.try(fn -> {:ok, 1} end), Fitting.try(fn -> Map.fetch!(%{}, "x") end)}
      {{:ok, 1}, :error}
  """
  @spec try((() -> result)) :: result | :error when result: term()
  def try(make) do
    make.()
  rescue
    _ in [
      ArgumentError,
      ArithmeticError,
      BadMapError,
      CaseClauseError,
      Enum.EmptyError,
      FunctionClauseError,
      KeyError,
      MatchError,
      Protocol.UndefinedError,
      WithClauseError
    ] ->
      :error
  end
end
