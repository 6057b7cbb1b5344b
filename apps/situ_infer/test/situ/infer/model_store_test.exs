defmodule Situ.Infer.ModelStoreTest do
  use ExUnit.Case, async: true
  alias Situ.Infer.ModelStore

  test "a model that is not there is an error that says how to fetch it" do
    assert {:error, error} = ModelStore.fetch("no-such-model", "x.onnx")
    assert error.code == :no_model_file
    assert error.fix =~ "bin/lib/fetch-model no-such-model" and error.why =~ ModelStore.folder()
  end
end
