defmodule Situ.Annotation.Test.Annotating do
  @moduledoc false
  # Generates annotations and edits for property tests.
  use Situ.Test.Property
  alias Situ.Annotation
  alias Situ.Annotation.{Edit, Layer, Schema}

  def schema do
    {:ok, schema} =
      Schema.parse(%{
        "name" => "Speech",
        "attributes" => [
          %{"name" => "Speech", "kind" => "finite", "values" => ["speaks", "laughs", "silent"]},
          %{"name" => "Words", "kind" => "text"},
          %{"name" => "Sure", "kind" => "number"},
          %{"name" => "Loud", "kind" => "bool"}
        ]
      })

    schema
  end

  @doc "Builds a layer from these spans, skipping overlapping ones."
  def layer(spans) do
    {:ok, layer} = Layer.new(schema())

    Enum.reduce(spans, layer, fn {from, length, track, value}, layer ->
      annotation = Annotation.new(from, from + length, track, %{"Speech" => value})

      case Layer.add(layer, annotation) do
        {:ok, layer, _} -> layer
        {:error, %{code: :overlap}} -> layer
      end
    end)
  end

  def spans do
    list(
      {integer(0, 100), integer(0, 30), one_of(["A", "B"]),
       one_of(["speaks", "laughs", "silent"])}
    )
  end

  @doc "Generates edits as data, `{name, numbers ...}`, which `run/2` applies to a layer."
  def edits do
    list(
      one_of([
        {:add, integer(0, 100), integer(0, 30), one_of(["A", "B"])},
        {:remove, integer(1, 12)},
        {:edge, integer(1, 12), one_of([:from, :to]), integer(-20, 150), boolean()},
        {:value, integer(1, 12), one_of(["speaks", "laughs", "sings"])},
        {:split, integer(1, 12), integer(0, 120)},
        {:merge, integer(1, 12), integer(1, 12)},
        {:rename, one_of(["A", "B", "C"]), one_of(["A", "B", "C"])},
        {:interval, integer(1, 12), integer(0, 100), integer(-5, 30)}
      ])
    )
  end

  def run({:add, from, length, track}, layer),
    do: Layer.add(layer, Annotation.new(from, from + length, track))

  def run({:remove, id}, layer), do: Layer.remove(layer, id)

  def run({:edge, id, edge, time, alone?}, layer),
    do: Edit.move_edge(layer, id, edge, time, alone: alone?)

  def run({:value, id, value}, layer), do: Layer.set_value(layer, id, "Speech", value)
  def run({:split, id, time}, layer), do: Edit.split_annotation(layer, id, time)
  def run({:merge, a, b}, layer), do: Edit.merge_annotations(layer, a, b)
  def run({:rename, from, to}, layer), do: Edit.rename_track(layer, from, to)

  def run({:interval, id, from, length}, layer),
    do: Edit.set_interval(layer, id, {from, from + length})
end
