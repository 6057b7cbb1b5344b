# The outputs of Situ's values. Each is composed of the kinos of the package Kino.
for struct <- [Situ.DepthImage, Situ.EncodedImage, Situ.Image] do
  defimpl Kino.Render, for: struct do
    def to_livebook(image) do
      case Situ.Studio.Preview.encode_image(image) do
        {:ok, type, data} ->
          data |> IO.iodata_to_binary() |> Kino.Image.new(type) |> Kino.Render.to_livebook()

        {:error, _} ->
          Kino.Render.Any.to_livebook(image)
      end
    end
  end
end

defimpl Kino.Render, for: Situ.PointCloud do
  def to_livebook(cloud) do
    html = cloud |> Situ.Studio.Preview.render() |> IO.iodata_to_binary()
    Kino.Render.to_livebook(Kino.HTML.new(html))
  end
end

defimpl Kino.Render, for: Situ.AudioBuffer do
  def to_livebook(audio) do
    html = audio |> Situ.Studio.Preview.render() |> IO.iodata_to_binary()
    outputs = [Kino.Audio.new(to_wav(audio), :wav), Kino.HTML.new(html)]
    Kino.Render.to_livebook(Kino.Layout.grid(outputs))
  end

  defp to_wav(audio) do
    folder = Situ.Error.unwrap!(Situ.TempFolder.create_folder("livebook"))

    try do
      path = Path.join(folder, "audio.wav")
      :ok = Situ.Media.Wav.write(path, audio)
      File.read!(path)
    after
      Situ.TempFolder.remove_folder(folder)
    end
  end
end

defimpl Kino.Render, for: Situ.Message do
  def to_livebook(message) do
    time = Kino.Text.new(Situ.Time.to_iso8601(message.originating_time))
    Kino.Render.to_livebook(Kino.Layout.grid([time, message.data]))
  end
end

defimpl Kino.Render, for: Situ.Recording do
  def to_livebook(recording) do
    case Situ.Studio.Preview.timeline(recording) do
      {:ok, svg} -> svg |> IO.iodata_to_binary() |> Kino.HTML.new() |> Kino.Render.to_livebook()
      {:error, _} -> Kino.Render.Any.to_livebook(recording)
    end
  end
end

defimpl Kino.Render, for: Situ.Stream do
  def to_livebook(%{name: nil} = stream), do: Kino.Render.Any.to_livebook(stream)
  def to_livebook(stream), do: stream |> Situ.Livebook.show() |> Kino.Render.to_livebook()
end

defimpl Kino.Render, for: Situ.Graph.Handle do
  def to_livebook(pipeline), do: pipeline |> Situ.Livebook.graph() |> Kino.Render.to_livebook()
end

defimpl Kino.Render, for: Situ.Pipeline.Report do
  def to_livebook(report) do
    graph = report.snapshot |> Situ.Livebook.to_mermaid() |> Kino.Mermaid.new(download: false)
    Kino.Render.to_livebook(Kino.Layout.tabs(Graph: graph, Report: Kino.Inspect.new(report)))
  end
end
