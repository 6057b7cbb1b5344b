defmodule Situ.Space.DepthCamera.LibraryTest do
  # Tests the libraries themselves: OpenNI's dummy device, and a folder as libfreenect's fakenect-record writes it.
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{CameraIntrinsics, CameraView, DepthImage, Error, Pipeline, Pose}
  alias Situ.Space.DepthCamera
  alias Situ.Space.DepthCamera.Library
  alias Situ.Space.DepthCamera.Library.PortProgram

  @moduletag :capture_log
  @dummy "openni2:Dummy"

  defp lens(width \\ 320),
    do: CameraIntrinsics.new!(width: width, height: 240, focal: {280, 280})

  defp start(opts) do
    me = self()

    Pipeline.start(fn p ->
      camera = DepthCamera.open(p, {Library, opts})
      Situ.each(camera.depth, fn data, message -> send(me, {:depth, data, message}) end)
      Situ.each(camera.color, fn data, message -> send(me, {:color, data, message}) end)
    end)
  end

  describe "OpenNI 2" do
    @describetag :depth_port

    test "emits depth and color as views, in order, as the device delivers them" do
      pose = Pose.new({0.0, 0.0, 2.0})
      before = Situ.Time.now()
      {:ok, pipeline} = start(device: @dummy, intrinsics: lens(), pose: pose)

      times =
        for _ <- 1..5 do
          assert_receive {:depth, %CameraView{viewed: depth, pose: ^pose} = view, message}
          assert view.intrinsics == lens()
          # Half of it is at 2 m, and the rest is unknown.
          assert {:ok, distance} = DepthImage.fetch_distance(depth, 0, 0)
          assert_in_delta distance, 2.0, 1.0e-9
          message.originating_time
        end

      assert_receive {:color, %CameraView{viewed: color, pose: ^pose}, _}
      assert {color.format, color.width, color.height} == {:rgb24, 320, 240}
      assert times == Enum.sort(times) and hd(times) > before
      assert Enum.at(times, -1) - hd(times) > 60_000_000

      info = Pipeline.info(pipeline)
      assert inspect(info) =~ "running"
      Pipeline.stop(pipeline)
    end

    test "the camera recovers when its program is killed" do
      {:ok, pipeline} = start(device: @dummy, intrinsics: lens())
      assert_receive {:depth, _, %{originating_time: first}}
      kill_programs(pipeline)
      flush()
      assert_receive {:depth, _, %{originating_time: later}}
      assert later > first
      Pipeline.stop(pipeline)
    end

    test "a missing camera, an unknown lens and images of another size are errors" do
      assert {:error, %Error{code: :no_camera} = error} = outcome(device: "openni2:nowhere")
      assert Exception.message(error) =~ "nowhere"
      assert {:error, %Error{code: :no_intrinsics}} = outcome(device: @dummy)

      assert {:error, %Error{code: :bad_camera} = error} =
               outcome(device: @dummy, intrinsics: lens(640))

      assert Exception.message(error) =~ "320x240"
      assert Exception.message(error) =~ "640x240"
    end

    test "a missing Kinect is an error" do
      assert {:error, %Error{code: :no_camera} = error} = outcome(device: "freenect:7")
      assert Exception.message(error) =~ "index 7"
      assert Library.list_cameras() |> Enum.all?(&(&1.kind == :depth_camera))
    end
  end

  describe "a folder written by fakenect-record" do
    @describetag :depth_port
    @describetag :tmp_dir

    test "converts sensor values to millimeters and ends with the folder", %{
      tmp_dir: folder
    } do
      record(folder, for(raw <- [0, 500, 800, 1000, 2047], do: raw))

      # A camera does not wait, so a busy machine may lose an image. Play it until a run has lost none.
      {depth, color} =
        Enum.find_value(1..20, fn _ ->
          {depth, _} = all = play(folder)
          assert depth != []
          length(depth) == 5 && all
        end)

      for %CameraView{intrinsics: lens} <- depth do
        assert {lens.width, lens.height} == {640, 480}
        assert_in_delta elem(lens.focal, 0), 575.8, 0.1
      end

      distances =
        for view <- depth do
          case DepthImage.fetch_distance(view.viewed, 5, 5) do
            {:ok, distance} -> distance
            _ -> nil
          end
        end

      # Another formula, fitted to measurements: 0.1236 tan(raw / 2842.5 + 1.1863) m, by S. Magnenat.
      for {raw, distance} <- Enum.zip([500, 800, 1000], Enum.slice(distances, 1, 3)) do
        assert_in_delta distance, 0.1236 * :math.tan(raw / 2842.5 + 1.1863), 0.03 * distance
      end

      assert List.last(distances) in [nil, 0.0]
      assert [%CameraView{viewed: %{format: :rgb24, data: <<1, 2, 3, _::binary>>}} | _] = color
    end

    test "a missing or truncated folder is an error", %{tmp_dir: folder} do
      assert {:error, %Error{code: :no_camera} = error} = outcome(device: "fakenect:/nowhere")
      assert Exception.message(error) =~ "INDEX.txt"
      record(folder, [500, 600])
      [picture | _] = Path.wildcard(Path.join(folder, "d-*"))
      File.write!(picture, "P5")
      assert {:error, %Error{code: :no_camera}} = outcome(device: "fakenect:" <> folder)
    end
  end

  test "a device that no driver knows is an error" do
    for device <- ["kinect", "freenect:x", "freenect:-1", ""] do
      assert_raise Error, fn ->
        Pipeline.run(fn p -> DepthCamera.open(p, {Library, device: device}) end) |> unwrap()
      end
    end
  end

  property "accepts only the program's own packets" do
    forall packet <- binary() do
      case PortProgram.decode_packet(packet) do
        {:picture, kind, _, _, {w, h}, pixels} ->
          byte_size(pixels) == w * h * if(kind == :depth, do: 2, else: 3)

        {:camera, name, _} ->
          String.valid?(name)

        {:failed, why} ->
          String.valid?(why)

        :error ->
          true
      end
    end
  end

  defp unwrap({:error, error}), do: raise(error)
  defp unwrap(other), do: other

  defp outcome(opts) do
    Pipeline.run(fn p ->
      camera = DepthCamera.open(p, {Library, opts ++ [reconnect: false]})
      Situ.each(camera.depth, fn _ -> :ok end)
    end)
  end

  # Returns the depth and color views from a folder.
  defp play(folder) do
    me = self()
    ref = make_ref()

    assert {:ok, _} =
             Pipeline.run(fn p ->
               camera =
                 DepthCamera.open(p, {Library, device: "fakenect:" <> folder, reconnect: false})

               Situ.each(camera.depth, &send(me, {ref, :depth, &1}))
               Situ.each(camera.color, &send(me, {ref, :color, &1}))
             end)

    {taken(ref, :depth), taken(ref, :color)}
  end

  defp taken(ref, kind) do
    receive do
      {^ref, ^kind, view} -> [view | taken(ref, kind)]
    after
      0 -> []
    end
  end

  # "P5 640 480 65535", a line break, then the sensor's numbers; the same for color.
  defp record(folder, values) do
    names =
      for {raw, i} <- Enum.with_index(values), kind <- ["d", "r"] do
        seconds =
          :erlang.float_to_binary(1000 + i / 30 + if(kind == "r", do: 0.01, else: 0.0),
            decimals: 6
          )

        name = "#{kind}-#{seconds}-#{i * 2_000_000}.#{if kind == "d", do: "pgm", else: "ppm"}"

        File.write!(
          Path.join(folder, name),
          if kind == "d" do
            ["P5 640 480 65535\n", :binary.copy(<<raw::little-16>>, 640 * 480)]
          else
            ["P6 640 480 255\n", :binary.copy(<<1, 2, 3>>, 640 * 480)]
          end
        )

        name
      end

    File.write!(Path.join(folder, "INDEX.txt"), Enum.join(names, "\n") <> "\n")
  end

  # The programs that processes of this pipeline started.
  defp kill_programs(_pipeline) do
    for port <- Port.list(),
        {:name, name} <- [Port.info(port, :name)],
        String.ends_with?(List.to_string(name), "depth_port"),
        {:os_pid, pid} <- [Port.info(port, :os_pid)],
        do: System.cmd("kill", ["-9", "#{pid}"])
  end

  defp flush do
    receive do
      {:depth, _, _} -> flush()
    after
      0 -> :ok
    end
  end
end
