from tsa_ctrl.cli import main

if __name__ == "__main__":
    main()
