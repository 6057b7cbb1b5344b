defmodule Situ.Studio.Plugins.Template do
  @moduledoc false
  # Writes the template of a new plug-in, for `situ plugin new`.
  alias Situ.Error

  @name ~r/\A[a-z][a-z0-9-]{0,39}\z/

  @doc """
  Writes a plug-in to the folder `name` below `parent`. Errors: `:bad_name`, `:exists`, `:not_saved`.

      iex> {:error, error} = Situ.Studio.Plugins.Template.write("My Plug-in", "/tmp")
      iex> error.code
      :bad_name
  """
  @spec write(String.t(), Path.t()) ::
          {:ok, folder :: Path.t(), files :: [Path.t()]} | {:error, Error.t()}
  def write(name, parent) do
    folder = Path.join(parent, name)

    cond do
      not (name =~ @name) ->
        {:error,
         Error.new(:bad_name, "invalid plug-in name #{inspect(name)}",
           fix: "use lowercase letters, digits and dashes, beginning with a letter"
         )}

      File.exists?(folder) ->
        {:error, Error.new(:exists, "#{folder} already exists", fix: "choose another name")}

      true ->
        write_template(folder, build_files(name))
    end
  end

  defp write_template(folder, files) do
    with :ok <- write_files(folder, files), do: {:ok, folder, Enum.map(files, &elem(&1, 0))}
  end

  @doc "Writes files, as pairs of a path and a text, below `folder`. Error: `:not_saved`."
  @spec write_files(Path.t(), [{Path.t(), String.t()}]) :: :ok | {:error, Error.t()}
  def write_files(folder, files) do
    Enum.each(files, fn {path, text} ->
      path = Path.join(folder, path)
      File.mkdir_p!(Path.dirname(path))
      File.write!(path, text)
    end)
  rescue
    error in File.Error ->
      {:error,
       Error.new(:not_saved, "cannot write #{error.path}",
         why: to_string(:file.format_error(error.reason))
       )}
  end

  defp build_files(name) do
    module = name |> String.replace("-", "_") |> Macro.camelize()
    file = String.replace(name, "-", "_")
    title = name |> String.replace("-", " ") |> String.capitalize()

    [
      {"plugin.json", manifest_text(name, title)},
      {"web/#{file}.js", script_text()},
      {"lib/#{file}.ex", adapter_text(name, module)},
      {"test/#{file}_test.exs", elixir_test(name, module)},
      {"test/#{file}_test.mjs", script_test(file)}
    ]
    |> Enum.map(fn {path, text} -> {path, String.replace(text, "FILE", file)} end)
  end

  defp manifest_text(name, title) do
    """
    {
      "plugin": 1,
      "id": "#{name}",
      "title": "#{title}",
      "parts": [
        {
          "kind": "visualizer",
          "id": "recent",
          "title": "#{title}",
          "types": ["signal"],
          "panel": "own",
          "script": "web/FILE.js",
          "data": "past",
          "options": {
            "seconds": {"type": "range", "min": 0.1, "max": 600, "default": 10, "title": "Seconds"},
            "color": {"type": "color", "title": "Colour"}
          }
        }
      ]
    }
    """
  end

  defp script_text do
    """
    // Draws the numbers of the last seconds, with the newest at the right.

    // Returns the canvas positions of the rows [milliseconds before the newest, number]. Pure, and tested separately.
    export function positions(rows, seconds, width, height) {
      const numbers = rows.map(([, n]) => n).filter(Number.isFinite);
      const low = Math.min(...numbers),
        high = Math.max(...numbers);
      const span = high - low || 1;
      return rows
        .filter(([, n]) => Number.isFinite(n))
        .map(([ms, n]) => [width * (1 + ms / (1000 * seconds)), height * (0.9 - (0.8 * (n - low)) / span)]);
    }

    export function open(host) {
      let rows = [];
      return {
        accept(data) {
          rows = data.rows ?? [];
        },
        draw(ctx, { width, height, options }) {
          ctx.strokeStyle = host.color();
          ctx.lineWidth = 2;
          ctx.beginPath();
          for (const [x, y] of positions(rows, options.seconds, width, height)) ctx.lineTo(x, y);
          ctx.stroke();
        },
        under: () => (rows.length ? [`${host.format(rows[rows.length - 1][1])}`] : []),
      };
    }
    """
  end

  defp adapter_text(name, module) do
    """
    defmodule #{module}.Magnitude do
      @moduledoc "Converts numbers to their magnitude, which every visualizer of signals can draw."
      @behaviour Situ.Studio.Adapter

      @impl true
      def about,
        do: %Situ.Studio.Adapter{id: "#{name}", title: "magnitude", from: [:signal], to: :signal}

      @impl true
      def adapt(data, _message) when is_number(data), do: {:ok, abs(data)}
      def adapt(_data, _message), do: :error
    end
    """
  end

  defp elixir_test(name, module) do
    """
    defmodule #{module}.Test do
      use ExUnit.Case, async: true

      test "the plug-in is valid" do
        plugin = Situ.Studio.Plugins.plugin(Path.expand("..", __DIR__))
        assert plugin.problem == nil
        assert [%{id: "#{name}/recent"}] = plugin.visualizers
      end

      test "a number's magnitude has no sign" do
        assert #{module}.Magnitude.adapt(-2.5, nil) == {:ok, 2.5}
        assert #{module}.Magnitude.adapt("loud", nil) == :error
      end
    end
    """
  end

  defp script_test(_file) do
    """
    import test from "node:test";
    import assert from "node:assert/strict";
    import { positions } from "../web/FILE.js";

    test("the newest is at the right, the largest on top", () => {
      const rows = [
        [-1000, 0],
        [0, 5],
      ];
      const found = positions(rows, 2, 100, 10).map(([x, y]) => [Math.round(x), Math.round(y)]);
      assert.deepEqual(found, [
        [50, 9],
        [100, 1],
      ]);
    });

    test("values that are not numbers are left out", () => {
      assert.deepEqual(positions([[0, null]], 2, 100, 10), []);
    });
    """
  end
end
