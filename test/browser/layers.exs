# Prints the annotation layers of a dataset file as JSON, as the library reads them: FILE.
[file] = System.argv()
{:ok, _} = Application.ensure_all_started(:situ_dataset)
alias Situ.Annotation.{Layer, Recording}
alias Situ.Dataset.{OpenSession, SessionLayers}
dataset = Situ.Dataset.open(file) |> Situ.Error.unwrap!()

layers =
  for session <- dataset.sessions,
      open = OpenSession.open(session),
      %{partition: partition, stream: stream, editable?: true} <- SessionLayers.list_layers(open) do
    {:ok, store} = OpenSession.fetch_store(open, partition)
    {:ok, layer} = Recording.load_layer(store, stream)

    items =
      for a <- Layer.annotations(layer),
          do: [a.track, a.to - a.from, a.values |> Map.values() |> hd(), a.proposed?]

    %{session: session.name, layer: stream, review: Layer.review_progress(layer), items: items}
  end

IO.puts(Situ.JSON.encode(layers))
