defmodule Situ.PythonTest do
  use ExUnit.Case, async: true
  import Situ.PythonPrograms

  alias Situ.{AudioBuffer, Error, Image, Pipeline, PointCloud, Rect, Tensor}

  @moduletag :tmp_dir
  @moduletag capture_log: true

  # Runs a component on values 10 ns apart and returns the data of its output.
  defp run_part(source, values, opts \\ []) do
    {type, opts} = Keyword.pop(opts, :type, :any)

    Situ.to_list(fn p ->
      p
      |> Situ.from_enumerable(values, every: 10, type: type)
      |> Situ.Python.component(source, opts)
    end)
  end

  # Like `run_part`, but returns the values that were emitted before an error, and the result of the run.
  defp collect_part(source, values, opts) do
    {:ok, agent} = Agent.start_link(fn -> [] end)

    result =
      Pipeline.run(fn p ->
        p
        |> Situ.from_enumerable(values, every: 10)
        |> Situ.Python.component(source, opts)
        |> Situ.each(fn value -> Agent.update(agent, &[value | &1]) end)
      end)

    {Enum.reverse(Agent.get(agent, & &1)), result}
  end

  defp fail_part(source, values, opts \\ []) do
    {_values, {:error, failure}} = collect_part(source, values, opts)
    if is_struct(failure, Error), do: failure, else: failure.error
  end

  describe "component/3" do
    test "keeps state, takes options and emits in order", %{tmp_dir: dir} do
      source =
        write_part(dir, """
        def setup(self, factor):
            self.factor, self.count = factor, 0

        def on_value(self, value, message):
            self.count += 1
            return {"out": [self.count, value * self.factor]}
        """)

      expected = for i <- 1..2_000, do: [i, i * 3]
      assert run_part(source, 1..2_000, options: [factor: 3]) == expected
    end

    test "exchanges all kinds of plain data", %{tmp_dir: dir} do
      source = write_part(dir, "def on_value(self, value, message):\n    return {'out': value}")

      values = [
        nil,
        true,
        -1,
        12_345_678_901_234_567_890,
        1.5,
        "text",
        <<255, 0>>,
        [],
        [1, [2]],
        {1, "a"},
        %{"k" => 1},
        :nan,
        %Rect{x: 1, y: 2, width: 3, height: 4},
        Situ.Pose.identity()
      ]

      assert run_part(source, values) == values
    end

    test "has several inputs and outputs, and emits the time of the message", %{tmp_dir: dir} do
      source =
        write_part(dir, """
        def on_left(self, value, message):
            return {"sum": value}

        def on_message(self, value, message):
            return {"name": message.input}
        """)

      ours = self()

      {:ok, _} =
        Pipeline.run(fn p ->
          left = Situ.from_enumerable(p, [{10, 1}, {30, 2}])
          right = Situ.from_enumerable(p, [{20, 5}])
          out = [sum: :integer, name: :string]
          parts = Situ.Python.component([left: left, right: right], source, out: out)
          Situ.each(parts.sum, fn n, m -> send(ours, {:sum, m.originating_time, n}) end)
          Situ.each(parts.name, fn n, m -> send(ours, {:name, m.originating_time, n}) end)
        end)

      for message <- [{:sum, 10, 1}, {:sum, 30, 2}], do: assert_received(^message)

      assert_received {:name, 20, "right"}
    end

    test "emits none, several, and last results", %{tmp_dir: dir} do
      source =
        write_part(dir, """
        def on_value(self, value, message):
            if value == 1:
                return None
            return [(message.time + 1, {"out": value}), (message.time + 2, {"out": value * 10})]

        def on_close(self, time):
            return {"out": "end"}
        """)

      assert run_part(source, [1, 2, 3]) == [2, 20, 3, 30, "end"]
    end

    test "names the input of a single stream by its type", %{tmp_dir: dir} do
      source = write_part(dir, "def on_rect(self, rect, message):\n    return {'out': rect.x}")
      rects = [%Rect{x: 1, y: 2, width: 3, height: 4}]
      assert run_part(source, rects, type: Rect) == [1]
    end

    test "completes structs by their defaults, and rejects incomplete ones", %{tmp_dir: dir} do
      source =
        write_part(dir, """
        def on_value(self, value, message):
            return {"out": [situ.Struct("Situ.Rect", {"x": 1, "y": 2, "width": 3, **value})]}
        """)

      out = [out: {:list, Rect}]

      assert run_part(source, [%{"height" => 4}], out: out) ==
               [[%Rect{x: 1, y: 2, width: 3, height: 4}]]

      error = fail_part(source, [%{}], out: out)
      assert error.code == :bad_python_value
      assert error.why =~ "height"
    end

    test "holds its input while the worker is busy", %{tmp_dir: dir} do
      # Python handles one message at a time, so an unlimited number in flight would be seen here.
      source =
        write_part(dir, """
        def on_value(self, value, message):
            time.sleep(0.02)
            return {"out": value}
        """)

      newest = Situ.Delivery.latest()
      values = fn p -> Situ.from_enumerable(p, 1..50, every: 1_000_000) end

      list = Situ.to_list(fn p -> Situ.Python.component(values.(p), source, policy: newest) end)

      assert List.last(list) == 50
      assert length(list) < 50
    end
  end

  describe "numpy" do
    @describetag :numpy

    test "gets images, audio, tensors and clouds, small and large", %{tmp_dir: dir} do
      source =
        write_part(dir, """
        def on_value(self, value, message):
            return {"out": [list(value.array.shape), float(value.array.sum()), value.array.flags.writeable]}
        """)

      image = fn w, h ->
        Image.new!(width: w, height: h, format: :rgb24, data: :binary.copy(<<1>>, w * h * 3))
      end

      audio =
        AudioBuffer.new!(
          format: Situ.AudioFormat.pcm(48_000, 1),
          data: :binary.copy(<<1, 0>>, 480)
        )

      tensor = Tensor.from_list([1.0, 2.0], :f32, {1, 2})

      assert run_part(source, [image.(4, 3), image.(640, 480), audio, tensor],
               python: numpy_python()
             ) ==
               [
                 [[3, 4, 3], 36.0, false],
                 [[480, 640, 3], 921_600.0, false],
                 [[480, 1], 480.0, false],
                 [[1, 2], 3.0, false]
               ]

      assert %PointCloud{} = struct(PointCloud, [])
    end

    test "returns large arrays, which may be kept while others follow", %{tmp_dir: dir} do
      source =
        write_part(dir, """
        def setup(self):
            self.kept = []

        def on_image(self, image, message):
            self.kept.append(image.array)
            same = all((kept == index).all() for index, kept in enumerate(self.kept))
            return {"image": image.array + (0 if same else 100)}
        """)

      images =
        for i <- 0..19 do
          Image.new!(width: 400, height: 300, format: :rgb24, data: :binary.copy(<<i>>, 360_000))
        end

      # The memory has room for 5 images.
      opts = [type: Image, out: [image: Image], python: numpy_python(), shared_memory: 2_000_000]
      assert run_part(source, images, opts) == images
    end
  end

  describe "a missing part" do
    test "is named in the error", %{tmp_dir: dir} do
      source = write_part(dir, "pass")
      assert %{code: :no_python, what: what} = fail_part(source, [1], python: dir)
      assert what =~ dir
      assert %{code: :no_python} = fail_part(source, [1], python: "no-such-python")
      assert %{code: :no_python_file} = fail_part("#{dir}/none.py:Part", [1])

      source = write_part(dir, "def on_value(self, value, message): pass")
      other = String.replace(source, ":Part", ":Prat")
      assert %{code: :no_python_class, why: "it defines Part"} = fail_part(other, [1])

      source = write_part(dir, "pass", "import no_such_module")
      assert %{code: :no_python_module, why: why, fix: fix} = fail_part(source, [1])
      assert why =~ "no_such_module" and fix =~ "pip install no_such_module"

      source = write_part(dir, "def on_valu(self, value, message): pass")
      assert %{code: :bad_component, what: what} = fail_part(source, [1])
      assert what =~ "on_value" and what =~ "on_valu"

      source = write_part(dir, "def setup(self, threshold): pass")
      assert %{code: :python_failed, why: why} = fail_part(source, [1])
      assert why =~ "missing 1 required positional argument: 'threshold'"

      assert_raise Error, ~r/does not name a Python class/, fn ->
        Situ.to_list(fn p -> p |> Situ.from_enumerable([1]) |> Situ.Python.component("a.py") end)
      end

      # Python without numpy.
      source =
        write_part(dir, "def on_value(self, v, m):\n    v.array", "sys.modules['numpy'] = None")

      assert %{fix: fix} = fail_part(source, [Tensor.zeros(:f32, {1})])
      assert fix =~ "pip install numpy"
    end
  end

  describe "an exception" do
    setup %{tmp_dir: dir} do
      body = """
      def setup(self):
          self.count = 0

      def on_value(self, value, message):
          self.count += 1
          if value == 3:
              raise ValueError("no three")
          return {"out": [value, self.count]}
      """

      {:ok, source: write_part(dir, body)}
    end

    test "stops the pipeline with the traceback and the time", %{source: source} do
      {values, {:error, _}} = collect_part(source, 1..6, [])
      assert values == [[1, 1], [2, 2]]
      error = fail_part(source, [1, 3])
      assert error.code == :python_failed
      assert error.what =~ "ValueError: no three"
      assert error.why =~ ~s|raise ValueError("no three")|
      assert is_integer(error.meta.originating_time)
    end

    test "with :skip loses the message and keeps the state", %{source: source} do
      {values, {:ok, _}} = collect_part(source, 1..6, on_error: :skip)
      assert values == [[1, 1], [2, 2], [4, 4], [5, 5], [6, 6]]
    end

    test "with :restart loses the message and the state", %{source: source} do
      {values, {:ok, _}} = collect_part(source, 1..6, on_error: :restart)
      assert values == [[1, 1], [2, 2], [4, 1], [5, 2], [6, 3]]
    end
  end

  describe "a worker that ends" do
    @deaths %{
      "kill" => {"os.kill(os.getpid(), 9)", "ended by signal 9"},
      "exit" => {"os._exit(3)", "ended with status 3"},
      "segfault" => {"import ctypes; ctypes.string_at(0)", "ended by signal 11"},
      "abort" => {"os.abort()", "ended by signal 6"},
      "close" => {"os.closerange(3, 100); os._exit(0)", "ended with status 0"}
    }

    for {name, {code, why}} <- @deaths do
      test "by #{name} is reported, and replaced", %{tmp_dir: dir} do
        source =
          write_part(dir, """
          def setup(self):
              self.count = 0

          def on_value(self, value, message):
              self.count += 1
              if value == 3:
                  print("about to end")
                  #{unquote(code)}
              return {"out": [value, self.count]}
          """)

        error = fail_part(source, 1..5)
        assert error.code == :python_ended
        assert error.why =~ unquote(why)
        assert error.why =~ "about to end"
        assert is_integer(error.meta.originating_time)

        for policy <- [:restart, :skip] do
          {values, {:ok, _}} = collect_part(source, 1..5, on_error: policy)
          assert values == [[1, 1], [2, 2], [4, 1], [5, 2]]
        end
      end
    end

    test "too often fails the pipeline", %{tmp_dir: dir} do
      source = write_part(dir, "def on_value(self, value, message):\n    os._exit(1)")

      {:error, error} =
        Pipeline.run(fn p ->
          p
          |> Situ.from_enumerable(1..1_000_000, every: 1_000_000)
          |> Situ.Python.component(source, on_error: :restart)
        end)

      assert error.code == :restarted_too_often
    end

    test "while the last results are awaited loses only the messages at which it ends", %{
      tmp_dir: dir
    } do
      source =
        write_part(dir, """
        def on_value(self, value, message):
            if value % 2:
                os._exit(1)
            return {"out": value}
        """)

      for policy <- [:restart, :skip] do
        {values, {:ok, report}} = collect_part(source, 1..10, on_error: policy)
        assert values == [2, 4, 6, 8, 10]
        assert report.skipped == %{"Part" => 5}
      end
    end

    test "after one of its inputs has closed waits for the other one", %{tmp_dir: dir} do
      source =
        write_part(dir, """
        def on_short(self, value, message):
            return None

        def on_long(self, value, message):
            if value == 3:
                os._exit(1)
            return {"out": value}

        def on_close(self, time):
            return {"out": "end"}
        """)

      for policy <- [:restart, :skip] do
        values =
          Situ.to_list(fn p ->
            short = Situ.from_enumerable(p, [{10, 0}])
            long = Situ.from_enumerable(p, for(i <- 1..200, do: {i * 20, i}))
            Situ.Python.component([short: short, long: long], source, on_error: policy)
          end)

        assert values == [1, 2] ++ Enum.to_list(4..200) ++ ["end"]
      end
    end

    test "with :skip is replaced as soon as possible", %{tmp_dir: dir} do
      source =
        write_part(dir, """
        def on_value(self, value, message):
            if value == 1:
                os.rename(__file__, __file__ + ".gone")
                os._exit(1)
            return {"out": value}
        """)

      ours = self()

      {:ok, p} =
        Pipeline.start_link(fn p ->
          p
          |> Situ.from_enumerable(1..1_000_000, every: 1_000_000)
          |> Situ.Python.component(source, on_error: :skip)
          |> Situ.each(&send(ours, &1))
        end)

      path = Path.join(dir, "part.py")
      assert Situ.Test.Eventually.eventually(fn -> File.exists?(path <> ".gone") end)
      File.rename!(path <> ".gone", path)
      assert_receive 2
      assert_receive 3
      {:ok, _} = Pipeline.stop(p)
    end

    test "with its component leaves no process", %{tmp_dir: dir} do
      source =
        write_part(dir, """
        def on_value(self, value, message):
            if hasattr(self, "child"):
                return None
            self.child = os.fork()
            if self.child == 0:
                time.sleep(1000)
            return {"out": [os.getpid(), self.child]}
        """)

      ours = self()

      {:ok, p} =
        Pipeline.start(fn p ->
          p
          |> Situ.from_enumerable(Stream.map(1..1_000_000, & &1), every: 1_000_000)
          |> Situ.Python.component(source)
          |> Situ.each(&send(ours, &1))
        end)

      assert_receive [worker, child]
      Process.exit(p, :kill)
      for process <- [worker, child], do: await_end(process)
    end
  end

  test "a component whose process is killed loses and repeats no result", %{tmp_dir: dir} do
    source = write_part(dir, "def on_value(self, value, message):\n    return {'out': value * 2}")
    test = self()
    counter = :counters.new(1, [])

    {:ok, p} =
      Pipeline.start(fn p ->
        p
        |> Situ.from_enumerable(1..3_000, every: 10)
        |> Situ.Python.component(source, on_error: :restart, name: "Double")
        |> Situ.each(fn value ->
          :counters.add(counter, 1, 1)
          # Once in a thousand results, the pipeline waits until the component has been killed.
          if rem(:counters.get(counter, 1), 1_000) == 500, do: await_kill(test)
          send(test, {:got, value})
        end)
      end)

    for _ <- 1..3 do
      assert_receive {:waiting, consumer}, 60_000
      [pid] = for %{nodes: ["Double"], pid: "#PID" <> pid} <- Pipeline.info(p).processes, do: pid
      pid |> String.to_charlist() |> :erlang.list_to_pid() |> Process.exit(:kill)
      send(consumer, :go_on)
    end

    assert {:ok, _report} = Pipeline.await(p, 60_000)
    {:messages, messages} = Process.info(self(), :messages)
    assert for({:got, value} <- messages, do: value) == for(i <- 1..3_000, do: i * 2)
  end

  defp await_kill(test) do
    send(test, {:waiting, self()})
    receive do: (:go_on -> :ok)
  end

  test "a value that cannot be sent is the error of its message only", %{tmp_dir: dir} do
    source = write_part(dir, "def on_value(self, value, message):\n    return {'out': value}")
    values = [1, 2, self(), 4]
    assert {[1, 2], {:error, error}} = collect_part(source, values, [])
    assert %{code: :not_writable} = error
    assert error.what =~ "cannot be sent to Python"
    assert {[1, 2, 4], {:ok, _report}} = collect_part(source, values, on_error: :skip)
    assert {[1, 2, 4], {:ok, _report}} = collect_part(source, values, on_error: :restart)
    assert {[1, 2, 4], {:ok, _report}} = collect_part(source, values, on_error: :skip, max: 2)
  end

  describe "a worker that misbehaves" do
    test "in an endless loop is killed after its timeout", %{tmp_dir: dir} do
      source =
        write_part(dir, """
        def on_value(self, value, message):
            while value == 2:
                pass
            return {"out": value}
        """)

      error = fail_part(source, 1..3, timeout: 300)
      assert error.code == :timeout
      {values, {:ok, _}} = collect_part(source, 1..3, timeout: 300, on_error: :restart)
      assert values == [1, 3]
    end

    test "by its output only fills the log", %{tmp_dir: dir} do
      source =
        write_part(dir, ~S"""
        def on_value(self, value, message):
            print("x" * 1_000_000)
            sys.stdout.buffer.write(os.urandom(10_000) + b"\n")
            sys.stderr.write("T\0\0\0\0\n" * 1_000)
            return {"out": value}
        """)

      assert run_part(source, 1..3) == [1, 2, 3]
    end

    test "by forking goes on", %{tmp_dir: dir} do
      source =
        write_part(dir, """
        def on_value(self, value, message):
            os.fork()
            return {"out": value}
        """)

      assert run_part(source, 1..3) == [1, 2, 3]
    end

    test "by its memory gets a MemoryError", %{tmp_dir: dir} do
      source =
        write_part(dir, """
        def on_value(self, value, message):
            return {"out": len(bytearray(10_000_000_000))}
        """)

      error = fail_part(source, [1], memory: 2_000_000_000)
      assert error.what =~ "MemoryError"
      assert error.fix == "increase memory:"
    end

    test "by its results gets an error that names them", %{tmp_dir: dir} do
      source = write_part(dir, "def on_value(self, value, message):\n    return value")

      returned = %{
        5 => "the handler returned a int, 5",
        [5] => "the list contains a int, 5",
        %{"x" => 1} => "there is no output 'x': the outputs are out"
      }

      for {value, what} <- returned, do: assert(fail_part(source, [value]).what =~ what)

      error = fail_part(source, [%{"out" => "a"}], out: [out: :number])
      assert error.code == :wrong_type
      assert error.what =~ ~s(the output out got "a")
      assert error.why == "its type is number"

      source = write_part(dir, "def on_value(self, value, message):\n    return {'out': self}")
      assert fail_part(source, [1]).what =~ "cannot encode a Part"
    end

    test "by a file in the current folder does not affect others", %{tmp_dir: dir} do
      # The worker starts in the folder of the VM, so this checks the search path.
      source =
        write_part(dir, """
        def on_value(self, value, message):
            return {"out": [path for path in sys.path if path in ("", os.getcwd())]}
        """)

      assert run_part(source, [1]) == [[]]
    end

    test "never creates atoms", %{tmp_dir: dir} do
      source =
        write_part(dir, """
        def on_value(self, value, message):
            return {"out": situ.Atom("never_heard_of_%d" % value)}
        """)

      assert run_part(source, [5_123]) == ["never_heard_of_" <> "5123"]
      assert_raise ArgumentError, fn -> String.to_existing_atom("never_heard_of_" <> "5123") end
    end
  end

  test "describes its process", %{tmp_dir: dir} do
    source = write_part(dir, "def on_value(self, value, message):\n    return {'out': value}")
    ours = self()

    {:ok, p} =
      Pipeline.start_link(fn p ->
        p
        |> Situ.from_enumerable(1..1_000_000, every: 1_000_000)
        |> Situ.Python.component(source)
        |> Situ.each(&send(ours, &1))
      end)

    assert_receive 1
    text = ~r/^Part, process \d+, Python 3\.[\d.]+, \d+ MB, \d+ % CPU, \d+ messages in flight$/

    # The description arrives after the first request for it.
    assert Situ.Test.Eventually.eventually(fn ->
             part = Enum.find(Pipeline.info(p).nodes, &(&1.path == "Part"))
             part.description != nil and part.description =~ text
           end)

    {:ok, _} = Pipeline.stop(p)
  end

  test "everything that a program has printed is logged before the pipeline ends", %{tmp_dir: dir} do
    source =
      write_part(
        dir,
        """
        def on_value(self, value, message):
            return {"out": value}

        def on_close(self, time):
            print("<4>" + "a long line " * 5000)
            print("<4>the last line")
        """
      )

    log = ExUnit.CaptureLog.capture_log(fn -> assert run_part(source, [1]) == [1] end)
    assert log =~ "Part: the last line"
  end

  test "logging has levels", %{tmp_dir: dir} do
    source =
      write_part(
        dir,
        """
        def on_value(self, value, message):
            logging.getLogger("lab").warning("careful\\nwith that")
            return {"out": value}
        """,
        "import logging"
      )

    log = ExUnit.CaptureLog.capture_log(fn -> assert run_part(source, [1]) == [1] end)
    assert log =~ "[warning] Part: lab: careful"
    assert log =~ "[warning] Part: with that"
  end
end
