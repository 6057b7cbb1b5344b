defmodule Situ.EditLog.JsonFormat do
  @moduledoc false
  # A document that is any JSON object, such as a layout, a schema, or settings.
  @behaviour Situ.EditLog.Document
  alias Situ.EditLog.{Changes, Mark}

  @impl true
  def parse(text, _path) do
    case Situ.JSON.decode(text) do
      {:ok, %{} = json} -> {:ok, Map.delete(json, "edits"), Mark.parse(json["edits"])}
      _ -> {:error, "it is not a JSON object"}
    end
  end

  @impl true
  def encode(json, _path, mark) do
    text = json |> Situ.JSON.encode_pretty() |> String.trim_trailing()

    case {mark, text} do
      {nil, text} -> text <> "\n"
      {mark, "{}"} -> ~s({"edits": #{mark}}\n)
      {mark, "{" <> rest} -> ~s({\n  "edits": #{mark},) <> rest <> "\n"
    end
  end

  @impl true
  def to_json(json, _path), do: json

  @impl true
  def from_json(json, _path), do: {:ok, json}

  @impl true
  def diff(before, later, _path), do: Changes.diff(before, later)

  @impl true
  def apply_change(json, change, _path), do: Changes.apply_change(json, change)
end
