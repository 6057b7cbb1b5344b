defmodule Situ.CLI.Release do
  @moduledoc false
  # `situ release`: the script bin/lib/build-release does the work, and the verb only provides the help.
  @behaviour Situ.CLI.Verb

  alias Situ.CLI.{Option, Verb}
  alias Situ.Error

  @impl true
  def verbs do
    [
      %Verb{
        words: ["release"],
        summary: "build an archive of Situ for machines without Elixir and Rust",
        about: """
        Builds situ-VERSION-linux-x86_64.tar.gz in FOLDER: the command line, the studio, the kernels, ONNX Runtime,
        Erlang, and the system libraries that they need, with their licences. The other machine needs Debian 12, or a
        distribution with glibc 2.36 or newer. Programs that Situ starts (FFmpeg, espeak-ng ...) are not included;
        `situ doctor` lists them there. The file SHA256SUMS contains the checksums.
        """,
        arguments: [
          folder: [kind: :folder, optional: true, doc: "default: the folder dist of the checkout"]
        ],
        options: [
          Option.new(:deb, :flag, "also build a Debian package, which recommends these programs")
        ],
        examples: ["situ release", "situ release /tmp/dist --deb"],
        run: fn _, _ ->
          raise Error.new(:no_checkout, "an archive is built from a checkout of Situ",
                  fix: "run `bin/situ release` in the checkout"
                )
        end
      }
    ]
  end
end
