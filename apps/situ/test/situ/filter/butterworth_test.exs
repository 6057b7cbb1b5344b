defmodule Situ.Filter.ButterworthTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Filter.Butterworth
  doctest Situ.Filter.Butterworth

  property "every filter is stable and has as many poles as its order requires" do
    forall {order, low, width, shape} <-
             {integer(1, 10), integer(1, 200), integer(2, 200),
              one_of([:lowpass, :highpass, :bandpass, :bandstop])} do
      band? = shape in [:bandpass, :bandstop]
      edges = if band?, do: [low / 1000, (low + width) / 1000], else: [low / 1000]
      sections = Butterworth.design_sections(shape, edges, order)

      poles =
        sections
        |> Enum.map(fn {_, _, _, _, a2} -> if a2 == 0.0, do: 1, else: 2 end)
        |> Enum.sum()

      # Poles inside the unit circle satisfy the stability triangle.
      poles == if(band?, do: 2 * order, else: order) and
        Enum.all?(sections, fn {_, _, _, a1, a2} -> abs(a2) < 1 and abs(a1) < 1 + a2 end)
    end
  end
end
