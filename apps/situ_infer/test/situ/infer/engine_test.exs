defmodule Situ.Infer.EngineTest do
  use ExUnit.Case, async: true

  # Runs in a separate VM because a process opens the library only once.
  @script """
  alias Situ.Infer.{Engine, Model}
  {:ok, _} = Application.ensure_all_started(:situ_infer)
  {:error, error} = Model.load(Model.bundled_path("face_landmark.onnx"))
  true = error.code == :no_onnxruntime and error.fix =~ "bin/setup"
  System.put_env("SITU_ONNXRUNTIME", "/etc/hostname")
  {:error, %{code: :no_onnxruntime}} = Model.load(Model.bundled_path("face_landmark.onnx"))
  options = Situ.Options.validate!([detector: :energy], Situ.Infer.VoiceActivity.options())
  {:ok, state} = Situ.Infer.VoiceActivity.init(options)
  {[], _} = Situ.Infer.VoiceActivity.handle_start(nil, state)
  System.delete_env("SITU_ONNXRUNTIME")
  {:ok, _} = Model.load(Model.bundled_path("face_landmark.onnx"))
  IO.puts("mended")
  """

  test "a missing library is an error with a fix and is searched for again" do
    paths = Enum.flat_map(:code.get_path(), &["-pa", to_string(&1)])
    env = [{"SITU_ONNXRUNTIME", "/nowhere/libonnxruntime.so"}]

    assert {"mended\n", 0} =
             System.cmd("elixir", paths ++ ["-e", @script], env: env, stderr_to_stdout: true)
  end
end
