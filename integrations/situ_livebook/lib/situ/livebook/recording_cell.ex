defmodule Situ.Livebook.RecordingCell do
  @moduledoc false
  # The smart cell that opens a recording: its fields are the path and the name of the variable.
  use Kino.JS, assets_path: "lib/assets/cell"
  use Kino.JS.Live
  use Kino.SmartCell, name: "Situ recording"

  @labels [{"path", "Recording"}, {"variable", "Assign to"}]

  @impl true
  def init(attrs, ctx) do
    fields = %{
      "path" => attrs["path"] || "recordings/first",
      "variable" => Kino.SmartCell.prefixed_var_name("recording", attrs["variable"])
    }

    {:ok, assign(ctx, fields: fields)}
  end

  @impl true
  def handle_connect(ctx),
    do: {:ok, %{fields: ctx.assigns.fields, labels: Enum.map(@labels, &Tuple.to_list/1)}, ctx}

  @impl true
  def handle_event("update", %{"field" => field, "value" => value}, ctx)
      when field in ["path", "variable"] and is_binary(value) do
    # An invalid name is replaced by the last valid one.
    value = if field == "path" or valid_name?(value), do: value, else: ctx.assigns.fields[field]
    broadcast_event(ctx, "update", %{"field" => field, "value" => value})
    {:noreply, assign(ctx, fields: Map.put(ctx.assigns.fields, field, value))}
  end

  defp valid_name?(name), do: Kino.SmartCell.valid_variable_name?(name)

  @impl true
  def to_attrs(ctx), do: ctx.assigns.fields

  @impl true
  def to_source(%{"path" => path, "variable" => variable}) do
    if valid_name?(variable) do
      variable = {String.to_atom(variable), [], nil}

      Kino.SmartCell.quoted_to_string(
        quote do
          {:ok, unquote(variable)} = Situ.Store.open(unquote(path))
          unquote(variable)
        end
      )
    else
      ""
    end
  end
end
