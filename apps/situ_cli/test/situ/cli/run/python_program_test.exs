defmodule Situ.CLI.Run.PythonProgramTest do
  use ExUnit.Case
  import ExUnit.CaptureIO
  alias Situ.CLI.Run.PythonProgram
  alias Situ.Store

  @moduletag :tmp_dir

  defp run(argv) do
    me = self()

    errors =
      capture_io(:stderr, fn ->
        output = capture_io(fn -> send(me, {:status, Situ.CLI.run(["run" | argv])}) end)
        send(me, {:output, output})
      end)

    assert_received {:status, status}
    assert_received {:output, output}
    {status, output, errors}
  end

  setup %{tmp_dir: folder} do
    program = Path.join(folder, "program.py")

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        store = Store.create(p, "input", folder)

        for name <- ["left", "right"] do
          p
          |> Situ.from_enumerable(1..20, every: Situ.Time.ms(1), type: :integer)
          |> Store.write(store, name)
        end
      end)

    %{program: program, input: Path.join(folder, "input"), output: Path.join(folder, "output")}
  end

  test "runs a component over a recording, and records its outputs", context do
    File.write!(context.program, """
    import situ

    class Scale(situ.Component):
        outputs = {"scaled": "integer", "text": "string"}

        def setup(self, factor=2):
            self.factor = factor

        def on_message(self, value, message):
            return {"scaled": value * self.factor, "text": str(value)}
    """)

    arguments = [context.program, "--input", context.input, "--speed", "max"]
    {status, _output, errors} = run(arguments)
    assert status != 0
    assert errors =~ "choose with --stream: left, right"

    arguments =
      arguments ++ ["--stream", "right", "--set", "factor=3", "--record", context.output]

    assert {0, output, _errors} = run(arguments)
    assert output =~ "Recorded 3 streams"
    store = Store.open!(context.output)
    assert Enum.map(Store.messages(store, "scaled"), & &1.data) == Enum.map(1..20, &(&1 * 3))
    assert Enum.map(Store.messages(store, "text"), & &1.data) == Enum.map(1..20, &to_string/1)
    assert Store.stream_info(store, "scaled") |> elem(1) |> Map.fetch!(:type) == :integer

    assert {0, "factor (default 2)\n", _} = run([context.program, "--options"])
    {status, _, errors} = run([context.program])
    assert status != 0 and errors =~ "add --input"
  end

  test "decodes the images of a recording for a handler of images", context do
    image = Situ.Image.new_filled(8, 4, :rgb24, [200, 100, 50])
    {:ok, jpeg} = Situ.ImageOps.encode_jpeg(image)

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        store = Store.create(p, "camera", context.tmp_dir)
        stream = Situ.from_enumerable(p, [jpeg, jpeg], every: 1, type: Situ.EncodedImage)
        Store.write(stream, store, "Camera")
      end)

    File.write!(context.program, """
    import situ

    class Size(situ.Component):
        outputs = {"size": "list"}

        def on_image(self, image, message):
            return {"size": [type(image).__name__, image.width, image.height]}
    """)

    camera = Path.join(context.tmp_dir, "camera")
    arguments = [context.program, "--input", camera, "--speed", "max", "--record", context.output]

    for more <- [[], ["--stream", "Camera"]] do
      assert {0, _, _} = run(arguments ++ more)

      assert context.output |> Store.open!() |> Store.messages("size") |> Enum.map(& &1.data) ==
               [["Image", 8, 4], ["Image", 8, 4]]
    end

    File.write!(context.program, """
    import situ

    class Size(situ.Component):
        def on_image(self, image, message):
            return {"size": image.width}
    """)

    assert {1, _, errors} = run(arguments)
    assert errors =~ "outputs = {'size': 'any'}"
  end

  test "takes packages from the metadata of a script" do
    text = """
    # /// script
    # requires-python = ">=3.11"
    # dependencies = [
    #   "numpy<3",
    #   'uvicorn[standard]',
    # ]
    # ///
    import numpy
    """

    assert PythonProgram.script_dependencies(text) == ["numpy<3", "uvicorn[standard]"]
    assert PythonProgram.script_dependencies("import numpy") == nil
    assert PythonProgram.script_dependencies("# /// script\n# dependencies = []\n# ///\n") == []
  end

  test "feeds several inputs by name, and runs sinks", context do
    File.write!(context.program, """
    import pathlib
    import situ

    class Pairs(situ.Component):
        def setup(self, path):
            self.path, self.lines = path, []

        def on_a(self, value, message):
            self.lines.append(f"a {value}")

        def on_b(self, value, message):
            self.lines.append(f"b {value}")

        def on_close(self, time):
            pathlib.Path(self.path).write_text("\\n".join(self.lines))
    """)

    streams = ["--stream", "a=left", "--stream", "b=right", "--set", "path=#{context.output}"]

    assert {0, _, _} =
             run([context.program, "--input", context.input, "--speed", "max"] ++ streams)

    lines = context.output |> File.read!() |> String.split("\n")
    assert Enum.filter(lines, &(&1 =~ "a")) == for(n <- 1..20, do: "a #{n}")
    assert length(lines) == 40

    {_, _, errors} = run([context.program, "--input", context.input, "--stream", "a=lef"])
    assert errors =~ "left"
  end

  test "runs a source, and names the classes if there are several", context do
    File.write!(context.program, """
    import situ

    class Numbers(situ.Component):
        outputs = {"number": "integer"}

        def produce(self):
            for number in range(10):
                yield {"number": number}

    class Other(Numbers):
        outputs = {"number": "strange"}
    """)

    {status, _, errors} = run([context.program])
    assert status != 0 and errors =~ "choose one with --module: Numbers, Other"
    assert {0, _, _} = run([context.program, "--module", "Numbers", "--record", context.output])

    assert context.output |> Store.open!() |> Store.messages("number") |> Enum.map(& &1.data) ==
             Enum.to_list(0..9)

    {_, _, errors} = run([context.program, "--module", "Other"])
    assert errors =~ ~s|unknown type of an output: "strange"|
    {_, _, errors} = run([context.program, "--module", "Numbers", "--input", context.input])
    assert errors =~ "Numbers is a source"
  end
end
