defmodule PluginFixture do
  @moduledoc false
  # The plug-in of the guide, broken plug-ins, and a gaze that moves from left to right over an
  # image.
  alias Situ.{Image, Point2}
  alias Situ.Studio.{GuidePlugin, History}

  @t0 1_767_225_600_000_000_000
  @second 1_000_000_000

  def folder(work) do
    folder = Path.join(work, "plugins")
    GuidePlugin.write(Path.join(folder, "gaze-heat-map"))

    broken(
      folder,
      "throws",
      "export const open = () => ({ draw() { throw new Error('no paint'); } });"
    )

    broken(
      folder,
      "unready",
      "export const open = () => { throw new Error('not in the mood'); };"
    )

    broken(folder, "syntax", "export const open = (((;")
    broken(folder, "silent", "export const shut = 1;")
    broken(folder, "idle", "export const open = () => {};")
    # This would fetch from elsewhere, which the page's policy forbids.
    broken(folder, "abroad", "import 'https://example.org/x.js'; export const open = () => ({});")

    own(folder, "counter", """
    export function open(host) {
      let told = null;
      return {
        accept: (message) => { told = message; host.el.textContent = `told ${message.data?.x}`; },
        draw(ctx, { width, height, options }) {
          ctx.fillStyle = options.color ?? "#00c060";
          ctx.fillRect(0, 0, width / 2, height);
        },
        under: () => [`x is ${host.format(told.data.x)}`],
      };
    }
    """)

    File.mkdir_p!(Path.join(folder, "torn"))
    File.write!(Path.join(folder, "torn/plugin.json"), "{")
    folder
  end

  defp broken(folder, id, script), do: own(folder, id, script)

  defp own(folder, id, script) do
    part = %{
      "kind" => "visualizer",
      "id" => "v",
      "title" => "Odd #{id}",
      "types" => ["Situ.Point2"],
      "panel" => "own",
      "script" => "web/v.js",
      "options" => %{"color" => %{"type" => "color", "title" => "Colour"}}
    }

    manifest = %{"plugin" => 1, "id" => id, "parts" => [part]}
    File.mkdir_p!(Path.join([folder, id, "web"]))
    File.write!(Path.join([folder, id, "plugin.json"]), Situ.JSON.encode(manifest))
    File.write!(Path.join([folder, id, "web/v.js"]), script)
  end

  def gaze do
    h = History.new(seconds: 3_600, live: false)
    gray = String.duplicate(<<90, 90, 90>>, 320)
    image = Image.new!(width: 320, height: 240, format: :rgb24, data: String.duplicate(gray, 240))

    for s <- 0..10 do
      Fixture.put(h, "Camera.Image", @t0 + s * @second, 0, image, s)

      for k <- 0..9, s < 10 do
        i = 10 * s + k
        time = @t0 + i * div(@second, 10)
        x = if s < 5, do: 80.0, else: 240.0
        Fixture.put(h, "Gaze.Point", time, 0, %Point2{x: x, y: 120.0}, i)
        angles = %{"yaw" => if(s < 5, do: 15, else: -15), "pitch" => 0}
        Fixture.put(h, "Gaze.Angles", time, 0, angles, i)
      end
    end

    h
  end
end
