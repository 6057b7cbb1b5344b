defmodule Situ.Filter.Butterworth do
  @moduledoc """
  Designs Butterworth filters as second-order sections, `{b0, b1, b2, a1, a2}`, which run one after the other.

      iex> [{b0, b1, b2, a1, a2}] = Situ.Filter.Butterworth.sections(:lowpass, [0.25], 2)
      iex> Enum.map([b0, b1, b2, a1, a2], &Float.round(&1, 6))
      [0.292893, 0.585786, 0.292893, -0.0, 0.171573]
  """

  @type section :: {float(), float(), float(), float(), float()}
  @typep complex :: {float(), float()}

  @doc "Returns the sections of a filter. `edges` (one, or low and high) are in cycles per sample, below 0.5."
  @spec sections(Situ.Filter.Fir.shape(), [float()], pos_integer()) :: [section()]
  def sections(shape, edges, order) do
    # The bilinear transform with T = 1 maps the analogue frequency w to 2 atan(w / 2).
    warped = Enum.map(edges, &(2 * :math.tan(:math.pi() * &1)))
    {zeros, at} = zeros(shape, warped)

    order
    |> prototype()
    |> Enum.flat_map(&place(shape, &1, warped))
    |> Enum.map(&bilinear/1)
    |> pairs()
    |> Enum.map(&section(&1, zeros, at))
  end

  # Returns the poles of the analogue low-pass filter with its edge at 1.
  @spec prototype(pos_integer()) :: [complex()]
  defp prototype(order) do
    for k <- 0..(order - 1) do
      angle = :math.pi() * (2 * k + order + 1) / (2 * order)
      # The middle pole of an odd order is real.
      if 2 * k + 1 == order, do: {-1.0, 0.0}, else: {:math.cos(angle), :math.sin(angle)}
    end
  end

  defp place(:lowpass, pole, [w]), do: [scale(pole, w)]
  defp place(:highpass, pole, [w]), do: [scale(reciprocal(pole), w)]
  defp place(:bandpass, pole, [low, high]), do: split(scale(pole, (high - low) / 2), low * high)

  defp place(:bandstop, pole, [low, high]),
    do: split(scale(reciprocal(pole), (high - low) / 2), low * high)

  # Returns both solutions of s^2 - 2 p s + centre^2 = 0.
  defp split(p, square) do
    {re, im} = times(p, p)
    root = root({re - square, im})
    [add(p, root), add(p, scale(root, -1.0))]
  end

  # Returns the two zeros of each section as coefficients of its numerator, and the frequency (in radians per sample)
  # at which its gain is 1.
  defp zeros(:lowpass, _), do: {{1.0, 2.0, 1.0}, 0.0}
  defp zeros(:highpass, _), do: {{1.0, -2.0, 1.0}, :math.pi()}

  defp zeros(:bandpass, [low, high]),
    do: {{1.0, 0.0, -1.0}, 2 * :math.atan(:math.sqrt(low * high) / 2)}

  defp zeros(:bandstop, [low, high]) do
    centre = 2 * :math.atan(:math.sqrt(low * high) / 2)
    {{1.0, -2 * :math.cos(centre), 1.0}, 0.0}
  end

  # Two conjugate poles or two real poles form one section; a single real pole may be left over.
  defp pairs(poles) do
    {real, complex} = Enum.split_with(poles, fn {_, im} -> abs(im) < 1.0e-12 end)
    upper = for {re, im} <- complex, im > 0, do: {-2 * re, re * re + im * im}
    upper ++ (real |> Enum.map(&elem(&1, 0)) |> Enum.sort() |> Enum.chunk_every(2))
  end

  defp section([p, q], zeros, at), do: section({-(p + q), p * q}, zeros, at)

  # A section with one pole uses one of the two equal zeros.
  defp section([p], {1.0, double, 1.0}, at), do: normal({1.0, double / 2, 0.0}, {-p, 0.0}, at)
  defp section({a1, a2}, zeros, at), do: normal(zeros, {a1, a2}, at)

  defp normal({b0, b1, b2}, {a1, a2}, at) do
    gain = magnitude({1.0, a1, a2}, at) / magnitude({b0, b1, b2}, at)
    {b0 * gain, b1 * gain, b2 * gain, a1, a2}
  end

  defp magnitude({c0, c1, c2}, w) do
    re = c0 + c1 * :math.cos(w) + c2 * :math.cos(2 * w)
    im = c1 * :math.sin(w) + c2 * :math.sin(2 * w)
    :math.sqrt(re * re + im * im)
  end

  # z = (2 + s) / (2 - s)
  defp bilinear({re, im}), do: times({2 + re, im}, reciprocal({2 - re, -im}))

  defp add({a, b}, {c, d}), do: {a + c, b + d}
  defp scale({a, b}, k), do: {a * k, b * k}
  defp times({a, b}, {c, d}), do: {a * c - b * d, a * d + b * c}

  defp reciprocal({a, b}) do
    square = a * a + b * b
    {a / square, -b / square}
  end

  defp root({a, b}) do
    size = :math.sqrt(:math.sqrt(a * a + b * b))
    angle = :math.atan2(b, a) / 2
    {size * :math.cos(angle), size * :math.sin(angle)}
  end
end
