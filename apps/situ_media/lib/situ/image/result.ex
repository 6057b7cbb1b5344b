defmodule Situ.Image.Result do
  @moduledoc false
  # The one place where the results of media functions turn into exceptions (the `!` twins).

  @spec unwrap!({:ok, value} | {:error, Exception.t()}) :: value when value: term()
  def unwrap!({:ok, value}), do: value
  def unwrap!({:error, error}), do: raise(error)
end
