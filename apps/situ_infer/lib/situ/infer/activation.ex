defmodule Situ.Infer.Activation do
  @moduledoc false
  # The functions that convert the raw scores of networks to probabilities.

  @doc "Computes the logistic function, which maps any number to 0..1."
  @spec sigmoid(number()) :: float()
  def sigmoid(x), do: 1.0 / (1.0 + :math.exp(min(max(-x, -80.0), 80.0)))

  @doc "Computes the softmax of a list: positive numbers with the sum 1."
  @spec softmax([number()]) :: [float()]
  def softmax(values) do
    most = Enum.max(values)
    powers = Enum.map(values, &:math.exp(max(&1 - most, -80.0)))
    sum = Enum.sum(powers)
    Enum.map(powers, &(&1 / sum))
  end
end
