defmodule Situ.Infer.SimpleVadTest do
  use ExUnit.Case, async: true
  import Situ.Test.Property, only: [property: 2]
  alias Situ.Infer.SimpleVad
  doctest Situ.Infer.SimpleVad

  property "the simple detector decides every value once, in order" do
    {:proper_types.list(:proper_types.range(0, 14)),
     fn values ->
       {out, vad} =
         values
         |> Enum.with_index()
         |> Enum.flat_map_reduce(SimpleVad.new(window: 25), fn {v, i}, vad ->
           SimpleVad.push(vad, i * 10, v)
         end)

       {last, _} = SimpleVad.close(vad)
       times = Enum.map(out ++ last, &elem(&1, 0))
       times == Enum.map(0..(length(values) - 1)//1, &(&1 * 10))
     end}
  end
end
