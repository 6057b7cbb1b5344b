defmodule Situ.Studio.Plugins.Manifest do
  @moduledoc """
  Reads the description of a plug-in from the `plugin.json` in its folder:

      {
        "plugin": 1,
        "id": "gaze-heat-map",
        "title": "Gaze heat map",
        "parts": [
          {
            "kind": "visualizer", "id": "heat", "title": "Heat map",
            "types": ["Situ.Point2"], "panel": "image",
            "script": "web/heat.js", "data": "past",
            "options": {"seconds": {"type": "range", "min": 1, "max": 600, "default": 10, "title": "Seconds"}}
          }
        ]
      }

  | key of a part | |
  |---|---|
  | `types` | the streams that it accepts: types as the stream's properties show them, or their shapes, or `["any"]` |
  | `panel` | `"image"` (over an image) or `"own"` (fills a panel); with a `module`, any kind that `drawer` supports |
  | `script` | the ES module below `web/` that draws |
  | `data` | `"message"` (default): the message at the cursor; `"past"`: the messages of the last `seconds` (option) |
  | `module` | the Elixir module (`Situ.Studio.Visualizer`) that builds the frames, instead of `data` |
  | `drawer` | the page's own visualizer that draws the frames of the `module`, instead of a `script` |
  | `options` | by name: `type` (`boolean`, `color`, `text`, `range`, `choice`), `title`, `default`, `min`, `max`, `choices` |

  Adapters, file formats and tasks are Elixir modules below `lib/` and are not listed.

      iex> {:error, error} = Situ.Studio.Plugins.Manifest.parse(~s({"plugin": 1, "id": "Gaze!"}))
      iex> error.what
      "the plug-in's manifest is invalid: \\"id\\" must be lowercase letters, digits and dashes, not \\"Gaze!\\""
  """
  alias Situ.Error
  alias Situ.Studio.{Layout, StreamInfo, Visualizer, Visualizers}

  @enforce_keys [:id, :title]
  defstruct [:id, :title, parts: []]

  @typedoc "A part is a visualizer. Its `module` is a string and is resolved once the code is loaded."
  @type part :: %{visualizer: Visualizer.t(), module: String.t() | nil, script: String.t() | nil}
  @type t :: %__MODULE__{id: String.t(), title: String.t(), parts: [part()]}

  @id ~r/\A[a-z0-9][a-z0-9-]{0,39}\z/
  @key ~r/\A[a-z][a-z0-9_]{0,31}\z/
  @script ~r/\Aweb\/[A-Za-z0-9_][A-Za-z0-9_.\/-]*\.m?js\z/
  @max_parts 50
  @max_options 40
  @max_bytes 200_000

  @doc "Loads the manifest in a file. Errors: `:bad_plugin`."
  @spec load(Path.t()) :: {:ok, t()} | {:error, Error.t()}
  def load(path) do
    case File.read(path) do
      {:ok, text} when byte_size(text) <= @max_bytes -> parse(text)
      {:ok, _} -> manifest_error("it is larger than #{@max_bytes} bytes")
      {:error, reason} -> manifest_error("#{path}: #{:file.format_error(reason)}")
    end
  end

  @doc "Parses a manifest. Errors: `:bad_plugin`, with the problem and where it is."
  @spec parse(String.t()) :: {:ok, t()} | {:error, Error.t()}
  def parse(text) do
    case Situ.JSON.decode(text) do
      {:ok, %{"plugin" => 1} = doc} ->
        parse_document(doc)

      {:ok, %{"plugin" => other}} ->
        manifest_error("this Situ reads version 1, not #{inspect(other)}")

      {:ok, _} ->
        manifest_error(~s(it must contain "plugin": 1))

      {:error, :bad_json} ->
        manifest_error("it is not JSON")
    end
  end

  defp parse_document(doc) do
    parts = doc["parts"] || []

    with :ok <- validate_id(doc["id"]),
         true <- (is_list(parts) and length(parts) <= @max_parts) || ~s("parts" must be a list),
         {:ok, parts} <- Error.map_ok(parts, &parse_part(&1, doc["id"])) do
      {:ok, %__MODULE__{id: doc["id"], title: title_or_default(doc, doc["id"]), parts: parts}}
    else
      what -> manifest_error(what)
    end
  end

  defp manifest_error(what) do
    {:error,
     Error.new(:bad_plugin, "the plug-in's manifest is invalid: #{what}",
       fix: "docs/guides/your-own-visualizer.md describes plugin.json"
     )}
  end

  defp validate_id(id) do
    if is_binary(id) and id =~ @id,
      do: :ok,
      else: ~s("id" must be lowercase letters, digits and dashes, not #{inspect(id, limit: 5)})
  end

  defp title_or_default(%{"title" => title}, _) when is_binary(title),
    do: String.slice(title, 0, 60)

  defp title_or_default(_, id), do: id

  defp parse_part(%{"kind" => "visualizer"} = doc, plugin) do
    with :ok <- validate_id(doc["id"]),
         {:ok, shapes} <- parse_types(doc["types"]),
         {:ok, panel} <- parse_panel(doc["panel"], doc["module"]),
         {:ok, script} <- parse_script(doc["script"]),
         {:ok, data} <- parse_data(doc["data"] || "message"),
         {:ok, module} <- parse_module(doc["module"]),
         {:ok, drawer} <- parse_drawer(doc["drawer"]),
         :ok <- check_drawable(script, drawer),
         {:ok, options} <- parse_options(doc["options"] || %{}) do
      visualizer = %Visualizer{
        id: "#{plugin}/#{doc["id"]}",
        title: title_or_default(doc, doc["id"]),
        panel: panel,
        shapes: shapes,
        module: Visualizers.Script,
        drawer: drawer,
        options: [visible: [type: :boolean, title: "Visible", default: true]] ++ options,
        plugin: plugin,
        data: data,
        asks: if(data == :past, do: [:seconds], else: [])
      }

      asks = if module, do: Keyword.keys(options), else: visualizer.asks
      {:ok, %{visualizer: %{visualizer | asks: asks}, module: module, script: script}}
    else
      what -> ~s(part #{inspect(doc["id"], limit: 5)}: #{what})
    end
  end

  defp parse_part(%{"kind" => kind}, _),
    do: ~s(the "kind" of a part must be "visualizer", not #{inspect(kind, limit: 5)})

  defp parse_part(_, _), do: ~s(a part must be an object with a "kind")

  defp parse_types(["any"]), do: {:ok, :any}

  defp parse_types([_ | _] = types) when length(types) <= 40 do
    with {:ok, shapes} <- Error.map_ok(types, &parse_type/1), do: {:ok, Enum.uniq(shapes)}
  end

  defp parse_types(_), do: ~s("types" must be a list of types, or ["any"])

  defp parse_type(type) when is_binary(type) do
    case Enum.find(StreamInfo.list_shapes(), &(Atom.to_string(&1) == type)) do
      nil -> {:ok, StreamInfo.shape_of_text(type)}
      shape -> {:ok, shape}
    end
  end

  defp parse_type(other), do: "#{inspect(other, limit: 5)} is not a type"

  # A script draws on a canvas that is over an image or fills a panel.
  defp parse_panel(name, nil) when name in ["image", "own"],
    do: {:ok, String.to_existing_atom(name)}

  defp parse_panel(name, module) when module != nil do
    case Enum.find(Layout.panel_kinds(), &(Atom.to_string(&1) == name)) do
      nil -> ~s("panel" must be one of #{Enum.join(Layout.panel_kinds(), ", ")})
      panel -> {:ok, panel}
    end
  end

  defp parse_panel(_, _), do: ~s("panel" must be "image" or "own"; other panels need a "module")

  defp parse_script(nil), do: {:ok, nil}

  defp parse_script(path) do
    if is_binary(path) and path =~ @script and ".." not in Path.split(path),
      do: {:ok, path},
      else:
        ~s("script" must be a file below web/ that ends with .js, not #{inspect(path, limit: 5)})
  end

  defp parse_data("message"), do: {:ok, :message}
  defp parse_data("past"), do: {:ok, :past}

  defp parse_data(other),
    do: ~s("data" must be "message" or "past", not #{inspect(other, limit: 5)})

  defp parse_module(nil), do: {:ok, nil}
  defp parse_module(name) when is_binary(name), do: {:ok, name}
  defp parse_module(_), do: ~s("module" must be the name of an Elixir module)

  defp parse_drawer(nil), do: {:ok, nil}
  defp parse_drawer(name) when is_binary(name) and byte_size(name) <= 40, do: {:ok, name}
  defp parse_drawer(_), do: ~s("drawer" must be the name of one of the page's visualizers)

  defp check_drawable(nil, nil), do: ~s(it needs a "script", or a "drawer")
  defp check_drawable(_, _), do: :ok

  defp parse_options(%{} = options) when map_size(options) <= @max_options,
    do: options |> Enum.sort() |> Error.map_ok(&parse_option/1)

  defp parse_options(_), do: ~s("options" must be an object with at most #{@max_options} entries)

  defp parse_option({key, %{"type" => type} = doc}) when is_binary(key) do
    with true <-
           key =~ @key || "option names consist of lowercase letters and _, not #{inspect(key)}",
         {:ok, type, default} <- parse_option_type(type, doc) do
      # A plug-in, which the user has installed, creates at most 40 atoms here.
      option = [type: type, title: title_or_default(doc, key)]

      {:ok,
       {String.to_atom(key), if(default == nil, do: option, else: option ++ [default: default])}}
    else
      what -> "option #{inspect(key)}: #{what}"
    end
  end

  defp parse_option({key, _}), do: ~s(option #{inspect(key)} needs a "type")

  defp parse_option_type("boolean", doc), do: check_default(:boolean, doc, &is_boolean/1)

  defp parse_option_type("text", doc),
    do: check_default(:text, doc, &(is_nil(&1) or is_binary(&1)))

  defp parse_option_type("color", doc),
    do: check_default(:color, doc, &(is_nil(&1) or &1 =~ ~r/\A#[0-9a-fA-F]{6}\z/))

  defp parse_option_type("range", %{"min" => min, "max" => max} = doc)
       when is_number(min) and is_number(max) and min < max,
       do: check_default({:range, min, max}, doc, &(is_number(&1) and &1 >= min and &1 <= max))

  defp parse_option_type("range", _), do: ~s(a range needs "min" below "max")

  defp parse_option_type("choice", %{"choices" => [_ | _] = choices} = doc) do
    if Enum.all?(choices, &is_binary/1),
      do: check_default({:in, choices}, doc, &(&1 in choices)),
      else: "choices must be strings"
  end

  defp parse_option_type("choice", _), do: ~s(a choice needs "choices")
  defp parse_option_type(other, _), do: "unknown type #{inspect(other, limit: 5)}"

  defp check_default(type, doc, fits?) do
    if fits?.(doc["default"]),
      do: {:ok, type, doc["default"]},
      else: "its default #{inspect(doc["default"], limit: 5)} is not one of its values"
  end
end
