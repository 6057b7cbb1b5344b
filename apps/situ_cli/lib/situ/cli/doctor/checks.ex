defmodule Situ.CLI.Doctor.Checks do
  @moduledoc false
  # The checks of `situ doctor`: tables of Situ's libraries, of programs, of models and of optional programs.
  alias Situ.CLI.Checkout
  alias Situ.CLI.Doctor.Check
  alias Situ.Infer.{Engine, ModelStore}

  @kernels [
    situ_store: {"situ_store_nif", "recordings"},
    situ_media: {"situ_media_nif", "images and audio"},
    situ_space: {"situ_space_nif", "point clouds and depth"},
    situ_infer: {"situ_infer_nif", "models"},
    situ_bridge: {"situ_bridge_nif", "files of other systems"}
  ]

  # Name, arguments that print the version, purpose, package of Debian, and whether most programs need it.
  @programs [
    {"ffmpeg", ["-version"], "video and audio files, cameras, network streams", "ffmpeg", true},
    {"espeak-ng", ["--version"], "text to speech", "espeak-ng", false},
    {"sqlite3", ["--version"], "ROS 2 bags (.db3)", "sqlite3", false},
    {"python3", ["--version"], "the Python package, downloads of models", "python3", false},
    {"elixir", ["--short-version"], "projects made by `situ new`", "elixir", false},
    {"node", ["--version"], "tests of plug-ins for the studio", "nodejs", false}
  ]

  @models [
    {"moonshine-tiny-en", "English speech to text, `situ talk`"},
    {"hibari", "a neural voice, `situ talk --voice hibari`"},
    {"pp-ocr-v4", "text in images"}
  ]

  # Application, path in its priv folder, purpose, option of bin/setup.
  @optional_programs [
    {:situ_bridge, "zenoh/zenoh_port", "live ROS 2 topics", "ros2"},
    {:situ_store, "objects/object_port", "recordings in object storage (S3)", "s3"},
    {:situ_space, "opencv/opencv_port", "chessboards and stereo", "opencv"},
    {:situ_space, "depth/depth_port", "depth cameras of OpenNI 2 and libfreenect", "depth"}
  ]

  @doc "Runs all checks."
  @spec run_all() :: [Check.t()]
  def run_all do
    Enum.map(@kernels, &check_kernel/1) ++
      [check_studio_server(), check_studio_page(), check_onnxruntime()] ++
      Enum.map(@programs, &check_program/1) ++
      Enum.map(@models, &check_model/1) ++
      Enum.map(@optional_programs, &check_optional_program/1)
  end

  defp check_kernel({app, {library, purpose}}) do
    path = Path.join(priv_folder(app), "native/#{library}.so")
    check = %Check{group: "Situ", name: library, status: :ok, purpose: purpose, required?: true}
    if File.exists?(path), do: check, else: missing(check, build_command())
  end

  defp check_studio_server do
    check = %Check{
      group: "Situ",
      name: "yaws",
      status: :ok,
      purpose: "the studio's web server",
      required?: true
    }

    if Code.ensure_loaded?(:yaws),
      do: %{check | found: application_version(:yaws)},
      else: missing(check, "sudo apt install erlang-yaws")
  end

  defp check_studio_page do
    check = %Check{
      group: "Situ",
      name: "browser code",
      status: :ok,
      purpose: "the studio",
      required?: true
    }

    built = Path.join(priv_folder(:situ_studio), "static/.built")
    if File.exists?(built), do: check, else: missing(check, setup_command(""))
  end

  defp check_onnxruntime do
    check = %Check{group: "Situ", name: "ONNX Runtime", status: :ok, purpose: "neural networks"}

    case Engine.Ort.ensure_library() do
      :ok -> check
      {:error, _} -> missing(check, setup_command(""))
    end
  end

  defp check_program({name, arguments, purpose, package, required?}) do
    check = %Check{
      group: "Programs",
      name: name,
      status: :ok,
      purpose: purpose,
      required?: required?
    }

    case System.find_executable(name) do
      nil -> missing(check, "sudo apt install #{package}")
      path -> %{check | found: program_version(path, arguments)}
    end
  end

  defp program_version(path, arguments) do
    with {text, 0} <- System.cmd(path, arguments, stderr_to_stdout: true),
         [version] <- Regex.run(~r/\d+\.\d+[0-9a-z.]*/, text) do
      version
    else
      _ -> nil
    end
  end

  defp check_model({name, purpose}) do
    check = %Check{
      group: "Models, downloaded when needed",
      name: name,
      status: :ok,
      purpose: purpose
    }

    if File.exists?(Path.join([ModelStore.models_folder(), name, "SHA256SUMS"])),
      do: check,
      else: missing(check, Checkout.script_path("lib/fetch-model") <> " #{name}")
  end

  defp check_optional_program({app, path, purpose, option}) do
    name = Path.basename(path)
    check = %Check{group: "Optional programs", name: name, status: :ok, purpose: purpose}

    if File.exists?(Path.join(priv_folder(app), path)),
      do: check,
      else: missing(check, setup_command(" --with #{option}"))
  end

  defp missing(check, fix), do: %{check | status: :missing, fix: fix}

  # A release does not contain bin/setup.
  defp setup_command(options) do
    setup = Checkout.script_path("setup")

    if File.exists?(setup),
      do: setup <> options,
      else: "build it in a checkout: bin/setup" <> options
  end

  defp build_command, do: Checkout.script_path("situ") <> " --version, which builds it"
  defp priv_folder(app), do: app |> :code.priv_dir() |> to_string()

  defp application_version(app) do
    _ = Application.load(app)
    with version when version != nil <- Application.spec(app, :vsn), do: to_string(version)
  end
end
