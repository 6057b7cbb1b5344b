# The edges of a moving square, by OpenCV. Run it with: mix run examples/edges.exs
draw = fn n ->
  for y <- 0..63,
      x <- 0..63,
      into: <<>>,
      do: if(x in n..(n + 20) and y in 20..40, do: <<255>>, else: <<0>>)
end

{:ok, _report} =
  Situ.Pipeline.run(fn p ->
    p
    |> Situ.from_enumerable(0..40, every: Situ.Time.ms(10))
    |> Situ.map(&Situ.Image.new!(width: 64, height: 64, format: :gray8, data: draw.(&1)))
    |> Situ.Evision.map(&Evision.canny(&1, 100, 200))
    |> Situ.map(fn edges -> edges.data |> :binary.bin_to_list() |> Enum.count(&(&1 > 0)) end)
    |> Situ.first()
    |> Situ.each(&IO.puts("pixels on edges: #{&1}"))
  end)
