defmodule Situ.Space.LeastSquares do
  @moduledoc false
  # Finds the values that minimize the sum of squares of a function's results, by
  # Levenberg-Marquardt with central differences. It suits a few dozen values and some thousand
  # results.
  alias Situ.Error

  @enough 1.0e-14
  @most 1.0e12

  @type result :: {:ok, {[float()], square :: float()}} | {:error, Error.t()}

  @doc """
  Minimizes from `start` in at most `rounds` steps. Results that are not numbers are an error.

      iex> curve = fn a, b -> for x <- 0..9, do: a * :math.exp(b * x / 10) end
      iex> off = fn [a, b] -> Enum.zip_with(curve.(a, b), curve.(2.0, 0.3), &(&1 - &2)) end
      iex> {:ok, {[a, b], square}} = Situ.Space.LeastSquares.minimize([1.0, 1.0], off, 50)
      iex> {Float.round(a, 6), Float.round(b, 6), square < 1.0e-12}
      {2.0, 0.3, true}
  """
  @spec minimize([float()], ([float()] -> [float()]), pos_integer()) :: result()
  def minimize(start, fun, rounds) do
    results = fun.(start)
    {:ok, iterate_steps(start, results, sum_of_squares(results), fun, 1.0e-3, rounds)}
  rescue
    ArithmeticError ->
      {:error,
       Error.new(:not_found, "the search left the range in which the function is defined",
         fix: "give a better start"
       )}
  end

  defp iterate_steps(values, _results, least, _fun, _damping, 0), do: {values, least}

  defp iterate_steps(values, _results, least, _fun, damping, _) when damping > @most,
    do: {values, least}

  defp iterate_steps(values, results, least, fun, damping, rounds) do
    columns = jacobian_columns(values, fun)
    normal = for a <- columns, do: for(b <- columns, do: dot_product(a, b))
    slope = for a <- columns, do: -dot_product(a, results)

    case try_step(values, least, normal, slope, fun, damping) do
      :none ->
        {values, least}

      {next, results, square, damping} ->
        if least - square <= @enough * (least + @enough),
          do: {next, square},
          else: iterate_steps(next, results, square, fun, damping, rounds - 1)
    end
  end

  # Increases the damping until a step reduces the error.
  defp try_step(_values, _least, _normal, _slope, _fun, damping) when damping > @most, do: :none

  defp try_step(values, least, normal, slope, fun, damping) do
    damped =
      for {row, i} <- Enum.with_index(normal),
          do: List.update_at(row, i, &(&1 + damping * max(&1, 1.0e-12)))

    with {:ok, move} <- solve_linear(damped, slope),
         next = Enum.zip_with(values, move, &(&1 + &2)),
         results = fun.(next),
         square when square < least <- sum_of_squares(results) do
      {next, results, square, max(damping / 10, 1.0e-12)}
    else
      _ -> try_step(values, least, normal, slope, fun, damping * 10)
    end
  end

  # Returns the derivatives of the results by each of the values.
  defp jacobian_columns(values, fun) do
    for i <- 0..(length(values) - 1) do
      h = 1.0e-6 * max(abs(Enum.at(values, i)), 1.0e-2)
      more = fun.(List.update_at(values, i, &(&1 + h)))
      less = fun.(List.update_at(values, i, &(&1 - h)))
      Enum.zip_with(more, less, fn a, b -> (a - b) / (2 * h) end)
    end
  end

  defp dot_product(a, b), do: sum_products(a, b, 0.0)
  defp sum_products([a | as], [b | bs], total), do: sum_products(as, bs, total + a * b)
  defp sum_products([], [], total), do: total

  defp sum_of_squares(results), do: dot_product(results, results)

  @doc """
  Solves a system of linear equations by elimination with partial pivoting. Returns `:error` for a singular system.

      iex> Situ.Space.LeastSquares.solve_linear([[0.0, 2.0], [1.0, 1.0]], [4.0, 5.0])
      {:ok, [3.0, 2.0]}
      iex> Situ.Space.LeastSquares.solve_linear([[1.0, 1.0], [1.0, 1.0]], [1.0, 2.0])
      :error
  """
  @spec solve_linear([[float()]], [float()]) :: {:ok, [float()]} | :error
  def solve_linear(rows, right) do
    rows |> Enum.zip_with(right, &(&1 ++ [&2])) |> eliminate_rows([])
  end

  defp eliminate_rows([], done), do: {:ok, back_substitute(done, [])}

  defp eliminate_rows(rows, done) do
    [pivot | rest] = Enum.sort_by(rows, &(-abs(hd(&1))))

    if abs(hd(pivot)) < 1.0e-300 do
      :error
    else
      reduced = for [first | row] <- rest, do: subtract_scaled(row, tl(pivot), first / hd(pivot))
      eliminate_rows(reduced, [pivot | done])
    end
  end

  defp subtract_scaled([a | as], [b | bs], by), do: [a - b * by | subtract_scaled(as, bs, by)]
  defp subtract_scaled([], [], _by), do: []

  # Starts with the last equation, which has one unknown, and continues upwards.
  defp back_substitute([], known), do: known

  defp back_substitute([[pivot | row] | above], known) do
    {factors, [right]} = Enum.split(row, length(known))
    back_substitute(above, [(right - dot_product(factors, known)) / pivot | known])
  end
end
