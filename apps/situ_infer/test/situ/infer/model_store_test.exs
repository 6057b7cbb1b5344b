defmodule Situ.Infer.ModelStoreTest do
  use ExUnit.Case, async: true
  alias Situ.Infer.ModelStore

  @tag :tmp_dir
  test "rejects a model file that was truncated or changed", %{tmp_dir: root} do
    folder = Path.join(root, "m")
    File.mkdir_p!(folder)
    path = Path.join(folder, "x.onnx")
    File.write!(path, "a network")
    fetch = fn -> ModelStore.fetch_path("m", "x.onnx", root) end

    # A file placed there by hand has no known checksum.
    assert fetch.() == {:ok, path}
    sum = Base.encode16(:crypto.hash(:sha256, "a network"), case: :lower)
    File.write!(Path.join(folder, "SHA256SUMS"), "#{sum}  x.onnx\n")
    assert fetch.() == {:ok, path}
    assert fetch.() == {:ok, path}

    for bytes <- ["a net", "a networK", ""] do
      File.write!(path, bytes)
      File.touch!(path, System.os_time(:second) + byte_size(bytes) + 10)
      assert {:error, %{code: :bad_model, why: why, fix: fix}} = fetch.()
      assert why =~ "SHA256SUMS" and fix =~ "fetch-model"
    end
  end

  test "a missing model is an error that says how to fetch it" do
    assert {:error, error} = ModelStore.fetch_path("no-such-model", "x.onnx")
    assert error.code == :no_model_file

    assert error.fix =~ "bin/lib/fetch-model no-such-model" and
             error.why =~ ModelStore.models_folder()
  end
end
