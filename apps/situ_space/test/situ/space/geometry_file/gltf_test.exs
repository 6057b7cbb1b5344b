defmodule Situ.Space.GeometryFile.GltfTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Error, JSON, Mesh, PointCloud, Store}
  alias Situ.Space.GeometryFile.Gltf

  # A triangle in glTF's plane of y (up) and x (left), with 16-bit numbers and two padding bytes.
  @places for x <- [0, 0, 0, 2, 0, 0, 0, 1, 0], into: <<>>, do: <<x::little-float-32>>
  @bytes <<@places::binary, 0::little-16, 1::little-16, 2::little-16, 0, 0>>

  defp scene(changes \\ %{}) do
    Map.merge(
      %{
        asset: %{version: "2.0"},
        scene: 0,
        scenes: [%{nodes: [0]}],
        nodes: [
          %{children: [1], translation: [0, 0, 10]},
          %{mesh: 0, scale: [1, 2, 1], rotation: [0, 0, :math.sqrt(0.5), :math.sqrt(0.5)]}
        ],
        meshes: [%{primitives: [%{attributes: %{POSITION: 0}, indices: 1}]}],
        accessors: [
          %{bufferView: 0, componentType: 5126, type: "VEC3", count: 3},
          %{bufferView: 1, componentType: 5123, type: "SCALAR", count: 3}
        ],
        bufferViews: [
          %{buffer: 0, byteOffset: 0, byteLength: 36},
          %{buffer: 0, byteOffset: 36, byteLength: 6}
        ],
        buffers: [%{byteLength: 44}]
      },
      changes
    )
  end

  defp glb(scene, bytes \\ @bytes) do
    json = IO.iodata_to_binary(JSON.encode(scene))
    json = json <> String.duplicate(" ", rem(4 - rem(byte_size(json), 4), 4))

    chunks =
      <<byte_size(json)::little-32, "JSON", json::binary, byte_size(bytes)::little-32, "BIN", 0,
        bytes::binary>>

    <<"glTF", 2::little-32, 12 + byte_size(chunks)::little-32, chunks::binary>>
  end

  defp vertices(mesh),
    do:
      for(
        {x, y, z} <- PointCloud.to_points(%PointCloud{points: mesh.vertices}),
        do: {round(x), round(y), round(z)}
      )

  test "places triangles at their nodes, with x forward and z up" do
    assert {:ok, %Mesh{} = mesh} = Gltf.parse_file(glb(scene()))

    # Scaled upwards, a quarter turn about the forward axis, 10 m forward: 2 left becomes 2 up, and 2 up becomes 2
    # right.
    assert vertices(mesh) == [{10, 0, 0}, {10, 0, 2}, {10, -2, 0}]
    assert mesh.indices == <<0::little-32, 1::little-32, 2::little-32>>
  end

  @tag :tmp_dir
  test "reads bytes from a file in its own folder only", %{tmp_dir: folder} do
    own = Path.join(folder, "own")
    File.mkdir_p!(Path.join(own, "parts"))
    File.write!(Path.join([own, "parts", "two words.bin"]), @bytes)
    File.write!(Path.join(folder, "outside.bin"), @bytes)

    write = fn uri ->
      text = JSON.encode(scene(%{buffers: [%{byteLength: 44, uri: uri}]}))
      File.write!(Path.join(own, "robot.gltf"), text)
      Situ.Space.GeometryFile.read(Path.join(own, "robot.gltf"))
    end

    {:ok, whole} = Gltf.parse_file(glb(scene()))
    assert write.("parts/two%20words.bin") == {:ok, whole}
    assert {:error, %{why: "the buffer file" <> _}} = write.("parts/none.bin")

    for outside <- [
          "../outside.bin",
          "parts/../../outside.bin",
          "%2e%2e/outside.bin",
          "/etc/passwd",
          "file:///etc/passwd",
          "",
          "a%00b",
          "%zz"
        ],
        do: assert({:error, %{code: :bad_file}} = write.(outside))

    assert {:error, %{why: why}} = Gltf.parse_file(File.read!(Path.join(own, "robot.gltf")))
    assert why =~ "file"
  end

  test "accepts required materials but not compression" do
    assert {:ok, _} = Gltf.parse_file(glb(scene(%{extensionsRequired: ["KHR_materials_unlit"]})))

    assert {:error, %{why: why}} =
             Gltf.parse_file(glb(scene(%{extensionsRequired: ["KHR_draco_mesh_compression"]})))

    assert why =~ "KHR_draco"
    assert {:error, _} = Gltf.parse_file(glb(scene(%{extensionsRequired: 3})))
  end

  test "reads bytes in the text, a matrix, strips, fans and points" do
    uri = "data:application/octet-stream;base64," <> Base.encode64(@bytes)
    matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 3, 1]

    text =
      JSON.encode(
        scene(%{buffers: [%{byteLength: 44, uri: uri}], nodes: [%{mesh: 0, matrix: matrix}]})
      )

    assert {:ok, mesh} = Gltf.parse_file(IO.iodata_to_binary(text))
    assert vertices(mesh) == [{3, 0, 0}, {3, 2, 0}, {3, 0, 1}]

    for {mode, count} <- [{0, 0}, {4, 1}, {5, 1}, {6, 1}] do
      meshes = [%{primitives: [%{attributes: %{POSITION: 0}, mode: mode}]}]
      assert {:ok, mesh} = Gltf.parse_file(glb(scene(%{meshes: meshes})))
      assert Mesh.triangle_count(mesh) == count
    end
  end

  test "an unreadable file gives the reason" do
    for {file, says} <- [
          {"{}", "version 2"},
          {"no json", "not valid JSON"},
          {<<"glTF", 2::little-32, 9::32, 900::little-32, "JSON">>, "cut off"},
          {glb(scene(%{extensionsRequired: ["KHR_draco_mesh_compression"]})), "draco"},
          {glb(scene(%{buffers: [%{uri: "../secret.bin"}]})), "own folder"},
          {glb(scene(%{nodes: [%{children: [0]}]})), "occurs twice"},
          {glb(scene(%{nodes: [%{children: [7]}]})), "item 7 of its nodes"},
          {glb(scene(), binary_part(@bytes, 0, 20)), "too early"},
          {glb(scene(), <<-1::128, @bytes::binary>>), "not finite"},
          {glb(scene(), @places <> <<0::16, 1::little-16, 9::little-16>>), "does not exist"},
          {glb(scene(%{scenes: [%{nodes: []}]})), "no surface"},
          {glb(scene(%{nodes: [%{mesh: 0, scale: ["x", 1, 1]}]})), "must have 3 numbers"},
          {glb(scene(%{meshes: 7})), "of its meshes"},
          {glb(scene(%{meshes: [%{primitives: 7}]})), "is not a list"}
        ] do
      assert {:error, %Error{code: :bad_file, why: why}} = Gltf.parse_file(file)
      assert why =~ says
    end
  end

  property "a file with a changed byte is read or rejected" do
    whole = glb(scene())

    forall {at, byte} <- {integer(0, byte_size(whole) - 1), integer(0, 255)} do
      <<before::binary-size(at), _, rest::binary>> = whole
      assert {kind, _} = Gltf.parse_file(<<before::binary, byte, rest::binary>>)
      assert kind in [:ok, :error]
    end
  end

  @tag :tmp_dir
  test "opens as a recording", %{tmp_dir: dir} do
    path = Path.join(dir, "chair.glb")
    File.write!(path, glb(scene()))
    assert {:ok, store} = Store.open(path)
    assert [%{data: %Mesh{}}] = Enum.to_list(Store.messages(store, "Mesh"))
  end
end
