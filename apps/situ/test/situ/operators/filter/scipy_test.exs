defmodule Situ.Filter.SciPyTest do
  # Compares the magnitude responses of every kind of filter with SciPy's (fixtures/make_scipy_filters.py).
  use ExUnit.Case, async: true
  alias Situ.Filter.{Fir, Iir}

  @rows "../../../fixtures/scipy_filters.json" |> Path.expand(__DIR__) |> File.read!()
  @external_resource Path.expand("../../../fixtures/scipy_filters.json", __DIR__)

  # Below this level, only rounding errors would be compared.
  @floor -120.0

  defp rows(design) do
    {:ok, rows} = Situ.JSON.decode(@rows)

    for %{"design" => ^design} = row <- rows,
        do: Map.update!(row, "kind", &String.to_atom/1)
  end

  defp check(row, response) do
    for {f, wanted} <- Enum.zip(row["frequencies"], row["db"]), wanted > @floor do
      got = response.(2 * :math.pi() * f / row["rate"])
      what = "#{row["kind"]} #{inspect(row["edges"])} order #{row["order"]} at #{f} Hz"
      assert_in_delta got, wanted, 0.1, what
    end
  end

  test "infinite filters match SciPy's Butterworth within 0.1 dB" do
    for row <- rows("butter") do
      filter = Iir.new(row["kind"], row["rate"], row["edges"], row["order"])
      check(row, fn w -> filter.sections |> Enum.map(&section(elem(&1, 0), w)) |> Enum.sum() end)
    end
  end

  test "finite filters match SciPy's firwin with a Hamming window within 0.1 dB" do
    for row <- rows("firwin") do
      taps = Fir.design_taps(row["kind"], row["rate"], row["edges"], row["order"])
      assert length(taps) == row["order"] + 1
      check(row, fn w -> taps |> transform(w) |> db() end)
    end
  end

  test "a filter changes a tone as its response predicts" do
    for {module, order} <- [{Iir, 4}, {Fir, 400}],
        {f, least, most} <- [{50, 0.97, 1.03}, {30, 0.0, 0.01}] do
      filter = module.new(:bandpass, 1000, [45, 55], order)
      tone = for i <- 0..3_999, do: :math.sin(2 * :math.pi() * f * i / 1000)
      {out, _} = Enum.map_reduce(tone, filter, &module.step(&2, &1))
      amplitude = out |> Enum.drop(2_000) |> Enum.max()

      assert amplitude >= least and amplitude <= most,
             "#{inspect(module)} at #{f} Hz: #{amplitude}"
    end
  end

  defp section({b0, b1, b2, a1, a2}, w),
    do: db(transform([b0, b1, b2], w)) - db(transform([1.0, a1, a2], w))

  defp transform(values, w) do
    values
    |> Enum.with_index()
    |> Enum.reduce({0.0, 0.0}, fn {v, n}, {re, im} ->
      {re + v * :math.cos(w * n), im - v * :math.sin(w * n)}
    end)
  end

  defp db({re, im}), do: 10 * :math.log10(re * re + im * im + 1.0e-60)
end
