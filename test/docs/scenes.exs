defmodule Scenes do
  @moduledoc false
  # What the pictures of the guides show: recordings and pipelines that consist of the guides' own code, as far as
  # possible. `pictures.exs` starts a studio with them.
  alias Situ.{Image, ImageOps, Pipeline, Store, Time}

  defp record(name, folder, fun, start \\ 0) do
    replay = [interval: {start, :unbounded}, speed: :max]

    {:ok, _} =
      Pipeline.run(fn p -> fun.(p, Store.create(p, name, folder)) end, pipeline: [replay: replay])
  end

  def walk(folder) do
    record("walk", folder, fn p, store ->
      p
      |> Situ.from_enumerable(0..499, every: Time.ms(10))
      |> Store.write(store, "Leg.Steps")
      |> Situ.map(&:math.sin(&1 / 20), type: :float)
      |> Store.write(store, "Leg.Angle", metadata: %{"unit" => "rad", "leg" => "left"})
    end)
  end

  # Results of operators below their input.
  def operators(folder) do
    record("operators", folder, fn p, store ->
      write = &Store.write(&1, store, "Level." <> &2)

      level =
        p
        |> Situ.from_enumerable(0..199, every: Time.ms(50))
        |> Situ.map(&(:math.sin(&1 / 18) + 0.35 * :math.sin(&1 * 2.1)), type: :float)

      write.(level, "Input")

      level
      |> Situ.window(Situ.Interval.past(Time.ms(500)), &average/1, type: :float)
      |> write.("Window")

      ticks = Situ.repeat(p, :tick, every: Time.ms(700), count: 14)
      level |> Situ.sample(ticks, Situ.Reproducible.nearest(Time.ms(50))) |> write.("Sampled")
      level |> Situ.map(&(&1 > 0.5), type: :boolean) |> write.("High")
    end)
  end

  defp average(values), do: Enum.sum(values) / max(length(values), 1)

  # The network of "Your own model" that scores how red, green and blue an image is.
  def colours(folder) do
    model = Path.join(folder, "colours.onnx")

    File.write!(
      model,
      Situ.Infer.Onnx.encode(
        inputs: [{"picture", :f32, {nil, 3, 32, 32}}],
        outputs: [{"scores", :f32, {nil, 3}}],
        nodes: [
          {"GlobalAveragePool", ["picture"], ["mean"], []},
          {"Flatten", ["mean"], ["scores"], [axis: 1]}
        ]
      )
    )

    record("colours", folder, fn p, store ->
      images =
        p
        |> Situ.from_enumerable(0..99, every: Time.ms(100))
        |> Situ.map(&hue_image(&1 / 100), type: Image)

      scores =
        images
        |> Situ.map(& &1, type: {:optional, Image})
        |> Situ.via(Situ.Infer.Classifier, path: model, labels: ["red", "green", "blue"], top: 3)

      images |> Situ.map(&encode_jpeg/1, type: Situ.EncodedImage) |> Store.write(store, "Camera")

      scores
      |> Situ.map(&Map.new/1, type: {:map, :string, :float})
      |> Store.write(store, "Scores")
    end)
  end

  defp hue_image(turn) do
    colour =
      for shift <- [0.0, 1 / 3, 2 / 3],
          do: round(128 + 120 * :math.cos(2 * :math.pi() * (turn - shift)))

    Image.new_filled(320, 180, :rgb24, colour)
  end

  # The detector of "Python components" finds the bright part of an image.
  def python(folder, guide, python) do
    [_, code] = Regex.run(~r/The file `detector.py`:\n\n```python\n(.*?)```/s, File.read!(guide))
    File.write!(Path.join(folder, "detector.py"), code)

    record("detector", folder, fn p, store ->
      images =
        p
        |> Situ.from_enumerable(0..119, every: Time.ms(50))
        |> Situ.map(&bright_image/1, type: Image)

      found =
        Situ.Python.component(images, Path.join(folder, "detector.py") <> ":Detector",
          python: python,
          options: [threshold: 200],
          out: [boxes: {:list, Situ.Rect}, count: :integer]
        )

      images
      |> Situ.map(&encode_jpeg/1, type: Situ.EncodedImage)
      |> Store.write(store, "Camera.Image")

      Store.write(found.boxes, store, "Camera.Boxes")
      Store.write(found.count, store, "Camera.Count")
    end)
  end

  defp bright_image(i) do
    x = round(140 + 110 * :math.sin(i / 19))
    y = round(75 + 50 * :math.sin(i / 11))
    {dark, bright} = {<<40, 44, 60>>, <<255, 240, 210>>}
    plain = :binary.copy(dark, 320)
    crossed = :binary.copy(dark, x) <> :binary.copy(bright, 44) <> :binary.copy(dark, 276 - x)
    rows = for row <- 0..179, into: "", do: if(row in y..(y + 29), do: crossed, else: plain)
    Image.new!(width: 320, height: 180, format: :rgb24, data: rows)
  end

  defp encode_jpeg(image) do
    {:ok, jpeg} = ImageOps.encode_jpeg(image, quality: 90)
    jpeg
  end

  # Questions and replies, word by word, from a service with the protocol of language models.
  def chat(folder, url) do
    record("chat", folder, fn p, store ->
      questions =
        p
        |> Situ.from_enumerable(
          ["What time is it?", "Thank you.", "Who painted it?", "Thank you."],
          every: Time.s(4)
        )
        |> Situ.map(& &1, type: :string)

      chat = Situ.via([in: questions], Situ.Chat, url: url, model: "small")
      Store.write(questions, store, "Chat.Question")
      chat.out |> Situ.map(& &1.text, type: :string) |> Store.write(store, "Chat.Reply")
    end)
  end

  # The pipelines whose graphs are shown.
  def pipelines do
    [
      {"Heartbeat", &heartbeat/1},
      {"Division", &division/1},
      {"Turns", &turns/1},
      {"Queue", &queue/1}
    ]
  end

  defp heartbeat(p) do
    p
    |> Situ.repeat(:beat, every: Time.ms(10), name: "Heartbeat")
    |> Situ.scan(0, fn :beat, n -> n + 1 end, name: "Count")
    |> Situ.each(fn _n -> :ok end, name: "Print")
  end

  defp division(p) do
    p
    |> Situ.repeat(:tick, every: Time.ms(50), name: "Numbers")
    |> Situ.scan(0, fn :tick, n -> rem(n + 1, 10) end, name: "Digit")
    |> Situ.map(&(100 / (&1 - 5)), name: "Divide", on_error: :skip, async: true)
    |> Situ.each(fn _value -> :ok end, name: "Print", async: true)
  end

  defp turns(p) do
    loudness =
      p
      |> Situ.repeat(:tick, every: Time.ms(20), name: "Microphone")
      |> Situ.scan(0, fn :tick, n -> n + 1 end, name: "Ticks")
      |> Situ.map(&abs(:math.sin(&1 / 60)), name: "Loudness")

    turns = Situ.via(loudness, Turns, threshold: 0.5)
    Situ.each(turns.began, fn true -> :ok end, name: "Listen", async: true)
    Situ.each(turns.ended, fn _seconds -> :ok end, name: "Answer", async: true)
  end

  defp queue(p) do
    {:ok, numbers} = GenServer.start_link(Scenes.Numbers, [])

    p
    |> Situ.GenStage.from(numbers, type: :integer, name: "Orders", subscribe: [max_demand: 10])
    |> Situ.map(&(&1 * &1), name: "Square", async: true)
    |> Situ.each(fn _number -> :ok end, name: "Store", async: true)
  end
end

defmodule Scenes.Numbers do
  @moduledoc false
  # An endless producer of GenStage, at most 50 events a second.
  use GenServer

  @impl true
  def init(_), do: {:ok, %{next: 1, demand: 0, consumer: nil}}

  @impl true
  def handle_info({:"$gen_producer", consumer, {:ask, n}}, state) do
    if state.consumer == nil, do: send(self(), :send)
    {:noreply, %{state | demand: state.demand + n, consumer: consumer}}
  end

  def handle_info(:send, state) do
    Process.send_after(self(), :send, 20)
    {:noreply, send_event(state)}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp send_event(%{demand: 0} = state), do: state

  defp send_event(%{consumer: {pid, ref}} = state) do
    send(pid, {:"$gen_consumer", {self(), ref}, [state.next]})
    %{state | next: state.next + 1, demand: state.demand - 1}
  end
end
