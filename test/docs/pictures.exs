# Starts a studio with what the guides make, and prints its address: a recording, a video file and running pipelines.
# Ends with its standard input. `test/docs/pictures` takes the pictures.
alias Situ.{Pipeline, Store, Time}

{:ok, _} = Application.ensure_all_started(:situ_studio)
[folder] = System.argv()

{:ok, _} =
  Pipeline.run(
    fn p ->
      store = Store.create(p, "walk", folder)

      steps =
        p |> Situ.from_enumerable(0..499, every: Time.ms(10)) |> Store.write(store, "Leg.Steps")

      steps
      |> Situ.map(&:math.sin(&1 / 20), type: :float)
      |> Store.write(store, "Leg.Angle", metadata: %{"unit" => "rad", "leg" => "left"})
    end,
    pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
  )

File.cp!(Situ.Examples.Demo.Options.default_clip(), Path.join(folder, "talk1.mp4"))

heartbeat = fn p ->
  p
  |> Situ.repeat(:beat, every: Time.ms(10), name: "Heartbeat")
  |> Situ.scan(0, fn :beat, n -> n + 1 end, name: "Count")
  |> Situ.each(fn _n -> :ok end, name: "Print")
end

division = fn p ->
  p
  |> Situ.repeat(:tick, every: Time.ms(50), name: "Numbers")
  |> Situ.scan(0, fn :tick, n -> rem(n + 1, 10) end, name: "Digit")
  |> Situ.map(&(100 / (&1 - 5)), name: "Divide", on_error: :skip, async: true)
  |> Situ.each(fn _value -> :ok end, name: "Print", async: true)
end

pipelines =
  for {name, build} <- [{"Heartbeat", heartbeat}, {"Division", division}] do
    {:ok, pipeline} = Pipeline.start(build, [])
    {name, pipeline}
  end

{:ok, studio} =
  Situ.Studio.start_link(port: 0, path: folder, pipelines: pipelines, id: "pictures")

IO.puts(Situ.Studio.url(studio))
IO.read(:stdio, :line)
