defmodule Situ.Bridge.Format.SafeConversion do
  @moduledoc false
  # A message that carries its own definition may have the name of a standard message but different fields.
  # Conversions that rely on the standard's fields therefore run inside `try_build/1`.

  @doc """
  Returns the result of `fun`, or `:error` if it raises because the message does not have the expected fields.

      iex> alias Situ.Bridge.Format.SafeConversion
      iex> {SafeConversion.try_build(fn -> {:ok, 1} end), SafeConversion.try_build(fn -> Map.fetch!(%{}, "x") end)}
      {{:ok, 1}, :error}
  """
  @spec try_build((() -> result)) :: result | :error when result: term()
  def try_build(fun) do
    fun.()
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
