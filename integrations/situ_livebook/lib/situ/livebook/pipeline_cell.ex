defmodule Situ.Livebook.PipelineCell do
  @moduledoc false
  # The smart cell that runs a pipeline with start and stop: its editor holds the body of the build function, and its
  # field the names of the streams to show.
  use Kino.JS, assets_path: "lib/assets/cell"
  use Kino.JS.Live
  use Kino.SmartCell, name: "Situ pipeline"

  @example """
  count = Situ.sequence(p, 0, &(&1 + 1), every: Situ.Time.ms(50), name: "Count")
  Situ.map(count, &:math.sin(&1 / 20), name: "Sine")
  """
  @labels [["show", "Show the streams"]]

  @impl true
  def init(attrs, ctx) do
    source = attrs["source"] || @example
    fields = %{"show" => attrs["show"] || "Sine"}

    {:ok, assign(ctx, fields: fields, source: source),
     editor: [source: source, language: "elixir"]}
  end

  @impl true
  def handle_connect(ctx), do: {:ok, %{fields: ctx.assigns.fields, labels: @labels}, ctx}

  @impl true
  def handle_event("update", %{"field" => "show", "value" => value}, ctx) when is_binary(value) do
    broadcast_event(ctx, "update", %{"field" => "show", "value" => value})
    {:noreply, assign(ctx, fields: %{"show" => value})}
  end

  @impl true
  def handle_editor_change(source, ctx), do: {:ok, assign(ctx, source: source)}

  @impl true
  def to_attrs(ctx), do: Map.put(ctx.assigns.fields, "source", ctx.assigns.source)

  # The body may be incomplete while it is being written; the notebook then shows the compiler's error.
  @impl true
  def to_source(%{"source" => source, "show" => show}) do
    names = show |> String.split(",") |> Enum.map(&String.trim/1) |> Enum.reject(&(&1 == ""))
    text = "Situ.Livebook.run(fn p ->\n#{source}\nend, show: #{inspect(names, limit: :infinity)})"

    try do
      text |> Code.format_string!() |> IO.iodata_to_binary()
    rescue
      _ in [SyntaxError, TokenMissingError] -> text
    end
  end
end
