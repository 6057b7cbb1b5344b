defmodule Situ.Filter.Butterworth do
  @moduledoc false
  # Designs Butterworth filters as second-order sections, `{b0, b1, b2, a1, a2}`, which run one after the other.
  # Source: Oppenheim & Schafer, Discrete-Time Signal Processing. The poles of the analogue prototype are moved to the
  # band and converted by the bilinear transform, with the edges prewarped.

  @type section :: {float(), float(), float(), float(), float()}
  @typep complex :: {float(), float()}

  @doc """
  Returns the sections of a filter. `edges` (one, or low and high) are in cycles per sample, below 0.5.

      iex> [{b0, b1, b2, a1, a2}] = Situ.Filter.Butterworth.design_sections(:lowpass, [0.25], 2)
      iex> Enum.map([b0, b1, b2, a1, a2], &Float.round(&1, 6))
      [0.292893, 0.585786, 0.292893, -0.0, 0.171573]
  """
  @spec design_sections(Situ.Filter.Fir.shape(), [float()], pos_integer()) :: [section()]
  def design_sections(shape, edges, order) do
    # The bilinear transform with T = 1 maps the analogue frequency w to 2 atan(w / 2).
    warped = Enum.map(edges, &(2 * :math.tan(:math.pi() * &1)))
    {zeros, at} = section_zeros(shape, warped)

    order
    |> prototype_poles()
    |> Enum.flat_map(&transform_pole(shape, &1, warped))
    |> Enum.map(&bilinear_transform/1)
    |> pair_poles()
    |> Enum.map(&build_section(&1, zeros, at))
  end

  # Returns the poles of the analogue low-pass filter with its edge at 1.
  @spec prototype_poles(pos_integer()) :: [complex()]
  defp prototype_poles(order) do
    for k <- 0..(order - 1) do
      angle = :math.pi() * (2 * k + order + 1) / (2 * order)
      # The middle pole of an odd order is real.
      if 2 * k + 1 == order, do: {-1.0, 0.0}, else: {:math.cos(angle), :math.sin(angle)}
    end
  end

  defp transform_pole(:lowpass, pole, [w]), do: [scale_complex(pole, w)]
  defp transform_pole(:highpass, pole, [w]), do: [scale_complex(reciprocal(pole), w)]

  defp transform_pole(:bandpass, pole, [low, high]),
    do: split_pole(scale_complex(pole, (high - low) / 2), low * high)

  defp transform_pole(:bandstop, pole, [low, high]),
    do: split_pole(scale_complex(reciprocal(pole), (high - low) / 2), low * high)

  # Returns both solutions of s^2 - 2 p s + centre^2 = 0.
  defp split_pole(p, square) do
    {re, im} = multiply_complex(p, p)
    root = complex_sqrt({re - square, im})
    [add_complex(p, root), add_complex(p, scale_complex(root, -1.0))]
  end

  # Returns the two zeros of each section as coefficients of its numerator, and the frequency (in radians per sample)
  # at which its gain is 1.
  defp section_zeros(:lowpass, _), do: {{1.0, 2.0, 1.0}, 0.0}
  defp section_zeros(:highpass, _), do: {{1.0, -2.0, 1.0}, :math.pi()}

  defp section_zeros(:bandpass, [low, high]),
    do: {{1.0, 0.0, -1.0}, 2 * :math.atan(:math.sqrt(low * high) / 2)}

  defp section_zeros(:bandstop, [low, high]) do
    centre = 2 * :math.atan(:math.sqrt(low * high) / 2)
    {{1.0, -2 * :math.cos(centre), 1.0}, 0.0}
  end

  # Two conjugate poles or two real poles form one section; a single real pole may be left over.
  defp pair_poles(poles) do
    {real, complex} = Enum.split_with(poles, fn {_, im} -> abs(im) < 1.0e-12 end)
    upper = for {re, im} <- complex, im > 0, do: {-2 * re, re * re + im * im}
    upper ++ (real |> Enum.map(&elem(&1, 0)) |> Enum.sort() |> Enum.chunk_every(2))
  end

  defp build_section([p, q], zeros, at), do: build_section({-(p + q), p * q}, zeros, at)

  # A section with one pole uses one of the two equal zeros.
  defp build_section([p], {1.0, double, 1.0}, at),
    do: normalize_gain({1.0, double / 2, 0.0}, {-p, 0.0}, at)

  defp build_section({a1, a2}, zeros, at), do: normalize_gain(zeros, {a1, a2}, at)

  defp normalize_gain({b0, b1, b2}, {a1, a2}, at) do
    gain = response_magnitude({1.0, a1, a2}, at) / response_magnitude({b0, b1, b2}, at)
    {b0 * gain, b1 * gain, b2 * gain, a1, a2}
  end

  defp response_magnitude({c0, c1, c2}, w) do
    re = c0 + c1 * :math.cos(w) + c2 * :math.cos(2 * w)
    im = c1 * :math.sin(w) + c2 * :math.sin(2 * w)
    :math.sqrt(re * re + im * im)
  end

  # z = (2 + s) / (2 - s)
  defp bilinear_transform({re, im}), do: multiply_complex({2 + re, im}, reciprocal({2 - re, -im}))

  defp add_complex({a, b}, {c, d}), do: {a + c, b + d}
  defp scale_complex({a, b}, k), do: {a * k, b * k}
  defp multiply_complex({a, b}, {c, d}), do: {a * c - b * d, a * d + b * c}

  defp reciprocal({a, b}) do
    square = a * a + b * b
    {a / square, -b / square}
  end

  defp complex_sqrt({a, b}) do
    size = :math.sqrt(:math.sqrt(a * a + b * b))
    angle = :math.atan2(b, a) / 2
    {size * :math.cos(angle), size * :math.sin(angle)}
  end
end
