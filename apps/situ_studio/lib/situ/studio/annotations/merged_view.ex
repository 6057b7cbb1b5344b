defmodule Situ.Studio.Annotations.MergedView do
  @moduledoc false
  # The layers of all annotators of an item that have the same schema as the open layer, and where they agree.
  alias Situ.Annotation.{Agreement, Consensus, Editor, Layer, Schema}
  alias Situ.Studio.Annotations
  alias Situ.Studio.Annotations.Layers

  @most 20_000
  @frames 200_000
  @finest 10_000_000

  @doc "Returns the layers that can be compared with the open one, which comes first: `[{name, layer}]`."
  @spec list_layers(map(), map()) :: [{String.t(), Layer.t()}]
  def list_layers(%{studio: studio, item: item}, %{stream: mine, editor: editor}) do
    own = Editor.current_layer(editor)

    others =
      for name <- Layers.list_names(item) -- [mine],
          {:ok, other} <- [Layers.open_editor(studio, item, name, nil)],
          layer = Editor.current_layer(other),
          comparable_layers?(own.schema, layer.schema),
          do: {name, layer}

    [{mine, own} | others]
  end

  defp comparable_layers?(%{attributes: [first | _]}, schema) do
    case Schema.find_attribute(schema, first.name) do
      nil -> false
      attribute -> attribute.kind == first.kind
    end
  end

  @doc "Returns the other layers, the segments, and Cohen's kappa of each other layer with the open one."
  @spec page_state([{String.t(), Layer.t()}]) :: {:ok, map()} | {:error, Situ.Error.t()}
  def page_state([{_mine, own} | others] = layers) do
    with {:ok, segments} <- Consensus.find_segments(layers) do
      {:ok,
       %{
         layers:
           for {name, layer} <- others do
             items = layer |> Layer.annotations() |> Enum.take(@most)

             %{
               stream: name,
               kappa: kappa(own, layer),
               items: Enum.map(items, &Annotations.annotation_to_map/1)
             }
           end,
         segments:
           for s <- Enum.take(segments, @most) do
             %{
               track: s.track,
               from: Integer.to_string(s.from),
               to: Integer.to_string(s.to),
               agree: s.agree?
             }
           end
       }}
    end
  end

  defp kappa(a, b) do
    times = for layer <- [a, b], x <- Layer.annotations(layer), t <- [x.from, x.to], do: t
    length = if times == [], do: 0, else: Enum.max(times) - Enum.min(times)

    case Agreement.compare_layers(a, b, frame: max(@finest, div(length, @frames))) do
      {:ok, %{kappa: kappa}} -> kappa
      {:error, _} -> nil
    end
  end

  @doc "Builds the layer of the consensus of all layers."
  @spec build_consensus([{String.t(), Layer.t()}]) :: {:ok, Layer.t()} | {:error, Situ.Error.t()}
  def build_consensus([{_, own} | _] = layers) do
    with {:ok, segments} <- Consensus.find_segments(layers),
         do: Consensus.build_layer(own.schema, segments)
  end
end
